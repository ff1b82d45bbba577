"""A probe by the latch of its axis: the controller itself stops the axis a stated distance behind the latched position
(LT; SMC-4000: L7138-7195, SMC-2000: L10166-10209).

The latch is armed while the axis is at rest (AL) and its input passive, and read once more before the move (PA) begins.
Of a contact between that reading and the begin, while nothing moves, the latch knows, and its target may not: the first
reading shows it, and the axis is stopped.
"""

from collections.abc import Collection, Mapping
from contextlib import suppress
from dataclasses import dataclass
from math import ceil

from adapters.contract import HostInterval, LimitMove, ProbedContact, ProbeMove
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.registers import exact_ramp, exact_speed
from adapters.yaskawa.common.watch import SettingsWatch
from adapters.yaskawa.language.words import stop_code_meaning
from adapters.yaskawa.shapes.model import RAMP_UNIT, SPEED_UNIT, ModelTraits
from adapters.yaskawa.triggers.latch import LATCH_INPUTS, PositionLatch
from adapters.yaskawa.wire.record import AXIS_LETTERS, DataRecord
from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal
from orchestrator.model.state import PROBE_BY_HOST, ProbeAbility

LATCH_S = 25e-6  # from the edge to the captured position, at most (SMC-4000: L413; SMC-2000: L3037)
LATCH_COUNTS = 1.0  # by which a captured position is rounded
REACTION_S = 0.005  # what the actual position is behind the commanded one, and two samples
RAMP_SHARE = 0.75  # of the acceleration, at least: registers have steps
MARGIN_COUNTS = 4.0  # the distance is a whole number of counts, as are both positions
LOOK_NS = 10 * NS_PER_MS
AT_TARGET, AT_END, BEHIND_TARGET = 40, 1, 42  # stop codes (L7151-7159)


def find_ability(motors: Mapping[str, int], latches: int) -> ProbeAbility:
    """Its latch input stops an axis, by a falling edge. motors: by axis, its index. latches: axes that have one."""
    return ProbeAbility(
        inputs={axis: [LATCH_INPUTS[index]] for axis, index in motors.items() if index < latches},
        levels=["active"],
        reaction_s=REACTION_S,
        ramp_share=RAMP_SHARE,
        margin_counts=MARGIN_COUNTS,
        contact_s=LATCH_S,
        contact_counts=LATCH_COUNTS,
    )


def require_encoder(axis: str, steppers: Collection[str]) -> None:
    """Raise `Refusal` for the axis of a step motor: the latch captures an encoder, and LT counts from there."""
    if axis in steppers:
        text = f"axis {axis} has a step motor, and the position of a contact is that of an encoder"
        raise Refusal("no-probe", text, PROBE_BY_HOST)


@dataclass(frozen=True, slots=True)
class LatchTarget:
    """The values of LT: off, and the model whose registers are used. watch: expects it to be off."""

    off: int
    model: ModelTraits
    watch: SettingsWatch


@dataclass(frozen=True, slots=True)
class ProbeRegisters:
    """Speed and ramp of a probe, and the distance from the latched position to its rest, counts."""

    speed: int
    ramp: int
    distance: int

    @classmethod
    def find(cls, axis: str, move: LimitMove, tick_s: float, model: ModelTraits) -> "ProbeRegisters":
        """Those of an axis that moves alone, or of the way of several on a line. Raises `Refusal` for a speed or a ramp
        that the registers do not have."""
        speed = exact_speed(axis, move.speed_counts_s, tick_s, model)
        ramp = exact_ramp(axis, move.ramp_counts_s2, tick_s, model)
        speed_counts_s, ramp_counts_s2 = speed / SPEED_UNIT / tick_s, ramp / RAMP_UNIT / tick_s**2
        if ramp_counts_s2 < RAMP_SHARE * move.ramp_counts_s2:
            text = f"axis {axis}: of its acceleration the controller has only a ramp of {ramp_counts_s2:g} counts/s²"
            raise Refusal("too-gentle", text, "give the axis another acceleration in the fleet file")
        distance = ceil(speed_counts_s**2 / (2 * ramp_counts_s2) + speed_counts_s * REACTION_S) + 1
        return cls(speed, ramp, distance)

    def list_commands(self, letter: str) -> tuple[str, ...]:
        """The commands that load speed and ramp."""
        return (f"AC{letter}={self.ramp}", f"DC{letter}={self.ramp}", f"SP{letter}={self.speed}")


class LatchProbe:
    """A probe of one axis. index: of its motor."""

    def __init__(self, device: SmcDevice, clock: Clock, latch: PositionLatch, target: LatchTarget, index: int) -> None:
        self._device = device
        self._clock = clock
        self._latch = latch
        self._target = target
        self._index = index
        self._letter = AXIS_LETTERS[index]

    async def run(self, axis: str, move: ProbeMove) -> ProbedContact | None:
        """As `ProbeDriver.probe_axis`. Raises `Refusal`, `ControllerFault`."""
        if not move.active:
            text = f"the latch of axis {axis} takes the edge at which its input becomes active, and no other"
            raise Refusal("probe-input", text, "probe until it is active, or let the computer stop it: `by: host`")
        stops, letter = self._device.stop_counts.stop_count(self._index), self._letter
        await self._latch.require_input(axis, self._index, move.point)
        operand = f"_LT{letter}"
        self._target.watch.expect_value(operand, None)
        try:
            return await self._move(axis, move, stops)
        except BaseException:
            brake_probe(self._device, self._index)
            raise
        finally:
            # A latch target that is left would end a later move at a contact.
            await self._device.session.send_command(f"LT{letter}={self._target.off}")
            self._target.watch.expect_value(operand, float(self._target.off))

    async def _move(self, axis: str, move: ProbeMove, stops: int) -> ProbedContact | None:
        device, letter = self._device, self._letter

        def require_no_stop() -> None:
            device.stop_counts.require_no_stop(axis, self._index, stops)

        registers = ProbeRegisters.find(axis, move, device.samples.tick_ns * 1e-9, self._target.model)
        latching = (f"AL{letter}", f"LT{letter}={registers.distance}", f"PA{letter}={move.end_counts}")
        async with device.exclusive_turn():
            await device.session.send_settings((*registers.list_commands(letter), *latching), require_no_stop)
            record, (is_armed,) = await device.read_record_with(f"_AL{letter}")
            if not is_armed:
                text = f"the input of axis {axis} became active before the probe began"
                raise Refusal("line-level", text, "move the axis away from the contact first")
            await device.begin_motion(axis, self._index, stops)
        sign = 1 if move.end_counts >= record.axes[self._index].commanded else -1
        return await self._wait(axis, move, registers.distance, sign)

    async def _wait(self, axis: str, move: ProbeMove, distance: int, sign: int) -> ProbedContact | None:
        """Wait for rest, and return the contact."""
        letter, armed_ns, captured_ns = self._letter, self._clock.now_ns(), 0
        while True:
            record, (is_armed, latched_counts) = await self._device.read_record_with(f"_AL{letter}", f"_RL{letter}")
            state = record.axes[self._index]
            if is_armed:
                armed_ns = record.sent_ns
                self._require_passive(axis, move, record)
            elif not captured_ns:
                captured_ns = record.received_ns
            if not state.is_moving:
                break
            if not is_armed and sign * (state.commanded - latched_counts) > distance + MARGIN_COUNTS:
                text = f"axis {axis} goes on behind its latch target"
                raise Refusal("probe-broken", text, "was the contact made before it moved? Probe from farther away")
            if await self._device.stop_counts.sleep_to_stop(LOOK_NS):
                raise make_stopped(axis)
        # The latch may have captured between its last reading and the end of the move.
        operands = (f"_AL{letter}", f"_RL{letter}", f"_SC{letter}")
        (is_armed, latched_counts, code), answer = await self._device.session.read_numbers(*operands)
        if code not in (AT_TARGET, AT_END, BEHIND_TARGET):
            meaning = stop_code_meaning(int(code))
            raise Refusal("probe-broken", f"axis {axis}: the probe {meaning.text}", meaning.remedy)
        if is_armed:
            return None
        early = latched_counts - sign * (move.speed_counts_s * LATCH_S + LATCH_COUNTS / 2)
        late = latched_counts + sign * LATCH_COUNTS / 2
        span = HostInterval(armed_ns, captured_ns or answer.received_ns)
        return ProbedContact(min(early, late), max(early, late), span)

    def _require_passive(self, axis: str, move: ProbeMove, record: DataRecord) -> None:
        """Raise `Refusal` where an input is active and its latch still armed: by its means the axis does not stop."""
        if not record.inputs >> move.point.number - 1 & 1:
            text = f"input {move.point.number} is active, and the latch of axis {axis} has not captured it"
            raise Refusal("probe-broken", text, "see the wire of the input, and CN of the controller")


def brake_probe(device: SmcDevice, index: int, *halts: str) -> None:
    """Stop the axis of a probe that is given up, as far as the link is open. halts: see `SmcDevice.brake_axes`."""
    with suppress(LinkClosed):
        device.brake_axes([index], *halts)


def brake_sequence(device: SmcDevice, *halts: str) -> None:
    """As `brake_probe`, with the axes of a line, along it (L13007)."""
    with suppress(LinkClosed):
        device.write_stop(*halts, "STS")


def make_stopped(axis: str) -> Refusal:
    """The refusal of a probe whose axis was stopped."""
    return Refusal("stopped", f"axis {axis} was stopped while it probed", "probe again")
