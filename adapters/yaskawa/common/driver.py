"""Driver code common to both models, over a device that each model provides."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import nullcontext
from typing import Generic, Literal, TypeVar

from adapters.abilities import (
    LimitDriver,
    ManualDriver,
    OutputDriver,
    PathDriver,
    RetargetDriver,
    SamplingDriver,
    SettingsDriver,
    ShownTriggerDriver,
)
from adapters.contract import (
    ChunkFit,
    ControllerIdentity,
    Driver,
    DriverSetup,
    JogMove,
    MoveSlots,
    PathChunk,
    SampledPositions,
    SamplingPlan,
    SettingDifference,
    SwitchedOutput,
)
from adapters.toolkit.refusals import log_refusals
from adapters.yaskawa.common import homing
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.jogging import YaskawaJogging
from adapters.yaskawa.common.sampling import DeviceSampling
from adapters.yaskawa.common.settings import load_soft_limits
from adapters.yaskawa.common.slots import SampleMover, make_slots
from adapters.yaskawa.common.start import SampleStart
from adapters.yaskawa.common.watch import SettingsWatch
from adapters.yaskawa.language.dialect import send_raw
from adapters.yaskawa.language.words import STOP_CODES
from adapters.yaskawa.wire.record import AXIS_LETTERS, OFF_ON_ERROR, AxisRecord, DataRecord
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.profile import Profile
from orchestrator.model.state import FaultReport

STEPPER_TYPE = 2.0  # motor types of step and direction: 2, -2, 2.5, -2.5 (SMC-4000: L7683-7704; SMC-2000: L10536)
# Indexed by whether the forward and the reverse switch are active.
LIMITS: dict[tuple[bool, bool], Literal["none", "forward", "reverse", "both"]] = {
    (False, False): "none",
    (True, False): "forward",
    (False, True): "reverse",
    (True, True): "both",
}
_Device = TypeVar("_Device", bound=SmcDevice)


class YaskawaDriver(
    Driver,
    SettingsDriver,
    PathDriver,
    RetargetDriver,
    SamplingDriver,
    ShownTriggerDriver,
    ManualDriver,
    LimitDriver,
    OutputDriver,
    Generic[_Device],
):
    """One controller of either model.

    motors: motor index by axis. watch: its settings.
    """

    NOT_BY_RAW: Sequence[str]
    """Beginnings of commands that are not answered by a line."""

    def __init__(
        self,
        setup: DriverSetup,
        motors: Mapping[str, int],
        device: _Device,
        start: SampleStart,
        watch: SettingsWatch,
    ) -> None:
        self._log = setup.log
        self._config = setup.config
        self._clock = setup.clock
        self._motors = motors
        self._second: Mapping[str, int] = {}
        """Of axes of two motors: the index of the second one."""
        self._device = device
        device.log = setup.log
        self._start = start
        self._watch = watch
        self._jogging = YaskawaJogging(device, setup.clock, motors)
        self._slots = make_slots(start, self._make_mover)
        self._steppers: set[str] = set()
        self._sampling: DeviceSampling

    async def connect(self) -> ControllerIdentity:
        self._start.drop_move()
        identity = await self._device.connect()
        self._log.info(f"connected to {identity.model} {identity.firmware}".rstrip(), serial=identity.serial)
        return identity

    async def close(self) -> None:
        self._log.info("link closed")
        await self._device.close()

    # Settings

    async def check_settings(self, *, everything: bool) -> Sequence[SettingDifference]:
        # Before a step in one turn: on a chain, the polls of the other controllers would come in between.
        async with self._device.exclusive_turn() if everything else nullcontext():
            return await self._watch.find_differences(everything=everything)

    # Polling

    def clock_mapping(self) -> TickMapping | None:
        return self._device.samples.current_mapping()

    async def _read_faults(self, record: DataRecord) -> Sequence[FaultReport]:
        faults: list[FaultReport] = []
        for name, index in self._all_motors:
            if self._off_by_error(record.axes[index]):
                words = STOP_CODES[8]
                faults.append(
                    FaultReport(code=words.code, text=f"axis {name} {words.text}", remedy=words.remedy, axis=name)
                )
        if any(record.axes[index].stop_code == 6 for _, index in self._all_motors):
            # The stop code persists until the next move; the input itself shows whether the abort is still active
            # (2.0g, L6790).
            (free,), _ = await self._device.session.read_numbers("_AB")
            if not free:
                words = STOP_CODES[6]
                faults.append(FaultReport(code=words.code, text="the abort input is active", remedy=words.remedy))
        return faults

    def _off_by_error(self, axis: AxisRecord) -> bool:
        """Return whether the axis was switched off by its error limit."""
        return bool(axis.status & OFF_ON_ERROR)

    # Steps

    @property
    def slots(self) -> MoveSlots:
        return self._slots

    def _make_mover(self) -> SampleMover:
        return SampleMover(self._start, self._jogging, self._log)

    async def load_chunk(self, chunk: PathChunk, mapping: TickMapping | None) -> ChunkFit:
        with log_refusals(self._log, "the loading of a chunk"):
            return await self._start.load_chunk(chunk, mapping)

    async def release_chunk(self, number: int) -> None:
        with log_refusals(self._log, "the release of a chunk"):
            await self._start.release_chunk(number)

    async def retarget(self, profiles: Mapping[str, Profile], from_s: float) -> Mapping[str, float]:
        with log_refusals(self._log, "a retarget"):
            return await self._start.extend_move(profiles, from_s)

    async def begin_sampling(self, axes: Sequence[str], period_ns: int, seconds: float) -> SamplingPlan:
        with log_refusals(self._log, "sampling"):
            return await self._sampling.begin(axes, period_ns, seconds)

    async def take_samples(self) -> SampledPositions:
        with log_refusals(self._log, "the fetching of samples"):
            return await self._sampling.take()

    async def read_triggers(self, known: Mapping[str, int]) -> Mapping[str, SwitchedOutput]:
        with log_refusals(self._log, "the reading of triggers"):
            return await self._start.player.read(known)

    async def take_triggers(self) -> Mapping[str, SwitchedOutput]:
        with log_refusals(self._log, "the fetching of triggers"):
            return await self._start.player.take()

    async def stop(self, *, abort: bool) -> None:
        self._device.stop_all(abort=abort)
        self._log.info("stop written", abort=abort)

    # Other operations

    @property
    def _all_motors(self) -> list[tuple[str, int]]:
        """Axes, each with the index of a motor: the first ones, then the second ones."""
        return [*self._motors.items(), *self._second.items()]

    def _find_motors(self, axes: Iterable[str]) -> list[tuple[str, int]]:
        """The same of some axes."""
        wanted_axes = set(axes)
        return [(name, index) for name, index in self._all_motors if name in wanted_axes]

    async def set_enabled(self, axes: Sequence[str], *, on: bool) -> None:
        motors = self._find_motors(axes)
        letters = "".join(AXIS_LETTERS[index] for _, index in motors)
        await self._device.session.send_command(("SH" if on else "MO") + letters)
        record = await self._device.read_record()
        for name, index in motors:
            if record.axes[index].is_enabled != on:
                raise Refusal(
                    "enable-failed", f"axis {name} does not switch {'on' if on else 'off'}", "query the reason with TC1"
                )

    async def home_axes(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, Refusal]:
        self._jogging.drop_jogs(axes)
        searched_axes = [(name, self._motors[name], self._config.axes[name]) for name in axes]
        return await homing.home_axes(self._device, self._clock, searched_axes, found)

    async def jog_axis(self, axis: str, move: JogMove) -> None:
        await self._jogging.start_jog(axis, move)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        self._device.stop_axes(index for _, index in self._find_motors(axes))

    async def load_soft_limits(self, limits: Mapping[str, tuple[int, int] | None]) -> None:
        await load_soft_limits(self._device, self._motors, limits, self._watch)

    async def set_output(self, number: int, *, on: bool) -> None:
        await self._device.session.send_command(f"{'SB' if on else 'CB'}{number}")

    async def clear_faults(self) -> None:
        # Reading the error code clears it (SMC-4000: L10257; SMC-2000: L11681); enabling clears the other traces of a
        # fault.
        reply = await self._device.session.query_lines("TC")
        self._log.info("error code cleared", code=reply.lines[0])
        await self._watch.restore_values()

    async def send_raw(self, command: str) -> str:
        return await send_raw(command, self._device.session.query_all, self.NOT_BY_RAW)
