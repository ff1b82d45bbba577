"""The reference of an axis of two motors: both home switches, and the beam squared by their offset.

Both motors go to the home switch of the first one together, fast and then slowly back over its edge (FE, L5168). There
they rest; the second one is not geared any more, and goes slowly to the edge of its own switch, at most `max_deviation`
from where it stood: its software limits are there. From the edge it goes by `square`. Then both counts are 0, and it is
geared again. HM and FI would set the count of one motor alone on the way (L14199), so that no difference would show how
far the motors are apart; FE leaves counts as they are.
"""

from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import ceil

from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.homing import SPEED_OF_LIMIT, require_at_rest
from adapters.yaskawa.common.registers import ramp_register, speed_register
from adapters.yaskawa.common.settings import load_registers
from adapters.yaskawa.language.words import stop_code_meaning
from adapters.yaskawa.pairs.gearing import LIMITS_OFF, MotorPair, engage_gear
from adapters.yaskawa.shapes.model import SMC4000
from adapters.yaskawa.wire.record import AXIS_LETTERS, DataRecord
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal, TuttiError
from orchestrator.model.fleet import Axis

EDGE_FOUND, MOVE_DONE = 9, 1  # stop codes (L9858-9899)
LIMITED = (2, 3)  # by a limit switch or a software limit
SLOW_SHARE = 0.1  # of the speed of the search, for the edges
PASSED_SAMPLES = 2
LOOK_NS = 20 * NS_PER_MS
REST_NS = NS_PER_S  # after a stop: longer than any ramp of a search


@dataclass(frozen=True, slots=True)
class _Counts:
    """Speeds (counts/s), ramp (counts/s²) and lengths (counts) of a search."""

    speed: float
    slow: float
    ramp: float
    reach: int
    square: int

    @classmethod
    def of(cls, axis: Axis) -> "_Counts":
        assert axis.rack is not None and axis.max_deviation is not None
        scale, ramp = float(axis.scale), axis.limits.acceleration
        speed = axis.homing.speed or min(SPEED_OF_LIMIT * axis.limits.velocity, axis.rack.fastest(ramp))
        slow = axis.homing.search_speed or SLOW_SHARE * speed
        reach, square = int(axis.max_deviation * scale), round(axis.square * float(axis.counts_per_unit))
        return cls(speed * scale, min(slow, speed) * scale, ramp * scale, reach, square)


class _NoEdge(TuttiError):
    """The second motor has come to its limits before the edge of its switch."""


class PairHoming:
    """The search of one axis. pair: its motors. since: numbers of stops, by index."""

    def __init__(self, device: SmcDevice, clock: Clock, pair: MotorPair, axis: Axis, since: Mapping[int, int]) -> None:
        self._device = device
        self._clock = clock
        self._pair = pair
        self._counts = _Counts.of(axis)
        self._axis = axis
        self._since = since

    async def run(self) -> Refusal | None:
        """Find both references and square the beam; why it has no reference, or None."""
        pair, counts = self._pair, self._counts
        try:
            record = await self._device.read_record()
            for index in pair.indices:
                require_at_rest(pair.axis, record.axes[index])
            await self._find_edge(pair.first, counts.speed)
            await self._find_edge(pair.first, counts.slow)
            await self._square()
        except Refusal as refusal:
            return refusal
        except BaseException:
            # After a cancellation the motors would continue without supervision.
            self._brake()
            raise
        return None

    async def _square(self) -> None:
        """Bring the second motor to its own reference, and by the offset from there."""
        device, pair = self._device, self._pair
        second = pair.letters[1]
        await device.session.send_command(f"GR{second}=0")
        try:
            stand_counts = (await device.read_record()).axes[pair.second].commanded
            end = await self._find_second(stand_counts) + self._counts.square
            if abs(end - stand_counts) > self._counts.reach:
                await self._move_second(stand_counts)
                raise self._make_refusal(f"is {self._length(end - stand_counts):.4g} off", "move one of the switches")
            await self._move_second(end)
            await device.session.send_command(_define_zero(pair))
        except BaseException:
            self._brake()
            raise
        finally:
            await self._gear_again()

    async def _find_second(self, stand_counts: int) -> int:
        """The count of the second motor at the edge of its switch, at most `max_deviation` from `stand_counts`."""
        counts, pair, device = self._counts, self._pair, self._device
        # It brakes behind its software limit (L5284), which it is seen to pass by a sample or two.
        tick_s = device.samples.tick_ns * 1e-9
        overrun = ceil(counts.slow**2 / (2 * counts.ramp) + PASSED_SAMPLES * counts.slow * tick_s) + 1
        reach = max(0, counts.reach - overrun)
        await load_registers(device, pair.axis, pair.second, {"BL": stand_counts - reach, "FL": stand_counts + reach})
        try:
            return await self._find_edge(pair.second, counts.slow)
        except _NoEdge:
            pass
        finally:
            await load_registers(device, pair.axis, pair.second, LIMITS_OFF)
        await self._move_second(stand_counts)
        raise self._make_refusal("has not come", "bring the beam square by hand, or look at its switch")

    def _make_refusal(self, found: str, remedy: str) -> Refusal:
        text = (
            f"axis {self._pair.axis}: the home switch of its second motor {found}, and {self._axis.max_deviation:g} "
            f"{self._axis.unit} are allowed"
        )
        return Refusal("not-squared", text, f"{remedy}; then home again")

    def _length(self, counts: int) -> float:
        return abs(self._axis.to_length(counts))

    # Motions of one motor

    async def _find_edge(self, index: int, speed: float) -> int:
        """Move to the edge of the home switch of a motor; the count at which it rests."""
        await self._load_speed(index, speed)
        await self._device.session.send_command(f"FE{AXIS_LETTERS[index]}")
        record = await self._run(index)
        code = record.axes[index].stop_code
        if code in LIMITED and index == self._pair.second:
            raise _NoEdge()
        self._require_code(code, EDGE_FOUND)
        return record.axes[index].commanded

    async def _move_second(self, end: int) -> None:
        index = self._pair.second
        if (await self._device.read_record()).axes[index].commanded == end:
            return
        await self._load_speed(index, self._counts.slow)
        await self._device.session.send_command(f"PA{AXIS_LETTERS[index]}={end}")
        self._require_code((await self._run(index)).axes[index].stop_code, MOVE_DONE)

    async def _load_speed(self, index: int, speed: float) -> None:
        tick_s, letter = self._device.samples.tick_ns * 1e-9, AXIS_LETTERS[index]
        ramp = max(SMC4000.ramp_step, ramp_register(self._counts.ramp, tick_s))
        speed_steps = max(SMC4000.speed_step, speed_register(speed, tick_s))
        await self._device.session.send_settings(
            (f"AC{letter}={ramp}", f"DC{letter}={ramp}", f"SP{letter}={speed_steps}")
        )

    async def _run(self, index: int) -> DataRecord:
        """Begin what is loaded, and wait for its end."""
        await self._device.begin_motion(self._pair.axis, index, self._since[index])
        while True:
            # A search begins at a sample after BG: until then the axis rests with the stop code of an earlier one.
            await sleep_ns(self._clock, LOOK_NS)
            record = await self._device.read_record()
            if not record.axes[index].is_moving:
                return record

    def _require_code(self, code: int, wanted: int) -> None:
        if code != wanted:
            stop = stop_code_meaning(code)
            text = f"axis {self._pair.axis}: homing {stop.text}"
            raise Refusal("homing-failed", text, stop.remedy or "check its switches")

    # The end

    def _brake(self) -> None:
        with suppress(LinkClosed):
            self._device.brake_axes(self._pair.indices)

    async def _gear_again(self) -> None:
        """Gear the second motor again, at rest. Where that is not possible, the watch of settings states it."""
        until_ns = self._clock.now_ns() + REST_NS
        with suppress(LinkClosed, ControllerFault, Refusal):
            while self._clock.now_ns() < until_ns:
                record = await self._device.read_record()
                if not any(record.axes[index].is_moving for index in self._pair.indices):
                    await engage_gear(self._device, self._pair)
                    return
                await sleep_ns(self._clock, LOOK_NS)
        self._device.log.warning(f"the second motor of axis {self._pair.axis} is not geared")


def _define_zero(pair: MotorPair) -> str:
    """The command that sets both counts at once, so that no reading comes between (DP, L4227)."""
    return "DP " + ",".join("0" if index in pair.indices else "" for index in range(max(pair.indices) + 1))
