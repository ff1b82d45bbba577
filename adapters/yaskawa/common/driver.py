"""What the drivers of both models do alike, over a device that each of them makes for itself."""

from collections.abc import Callable, Mapping, Sequence
from typing import Generic, Literal, TypeVar

from adapters.contract import CannotDo, Driver, Identity, JogMove, Outcome, Setup, Span
from adapters.yaskawa.common import homing
from adapters.yaskawa.common.dialect import send_raw
from adapters.yaskawa.common.jogging import Jogging
from adapters.yaskawa.common.record import AXIS_LETTERS, OFF_ON_ERROR, AxisRecord, Record
from adapters.yaskawa.common.settings import load_limits
from adapters.yaskawa.common.start import Start
from adapters.yaskawa.common.words import STOP_CODES
from adapters.yaskawa.smc4000.device import Device
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.state import Fault

STEPPER_TYPE = 2.0  # motor types of step and direction: 2, -2, 2.5, -2.5 (SMC-4000: L7683-7704; SMC-2000: L10536)
# By whether the forward and the reverse switch are pressed.
LIMITS: dict[tuple[bool, bool], Literal["none", "forward", "reverse", "both"]] = {
    (False, False): "none",
    (True, False): "forward",
    (False, True): "reverse",
    (True, True): "both",
}
_Device = TypeVar("_Device", bound=Device)


class YaskawaDriver(Driver, Generic[_Device]):
    """One controller of either model.

    motors: their indices by axis. not_by_raw: beginnings of commands that are not answered by a line.
    """

    def __init__(
        self, setup: Setup, motors: Mapping[str, int], device: _Device, start: Start, not_by_raw: Sequence[str]
    ) -> None:
        self._config = setup.config
        self._clock = setup.clock
        self._motors = motors
        self._device = device
        self._start = start
        self._jogging = Jogging(device, setup.clock, motors)
        self._steppers: set[str] = set()
        self._not_by_raw = not_by_raw

    async def connect(self) -> Identity:
        self._start.forget()
        return await self._device.connect()

    async def close(self) -> None:
        await self._device.close()

    # Reading it

    def mapping(self) -> TickMapping | None:
        return self._device.samples.mapping()

    async def _faults(self, record: Record) -> Sequence[Fault]:
        faults: list[Fault] = []
        for name, index in self._motors.items():
            if self._off_by_error(record.axes[index]):
                words = STOP_CODES[8]
                faults.append(Fault(code=words.code, text=f"axis {name} {words.text}", remedy=words.remedy, axis=name))
        if any(record.axes[index].stop_code == 6 for index in self._motors.values()):
            # The stop code stays until the next move; the input itself says whether it is still so (2.0g, L6790).
            (free,), _ = await self._device.session.numbers("_AB")
            if not free:
                words = STOP_CODES[6]
                faults.append(Fault(code=words.code, text="the abort input is active", remedy=words.remedy))
        return faults

    def _off_by_error(self, axis: AxisRecord) -> bool:
        """Whether the axis was switched off by its error limit."""
        return bool(axis.status & OFF_ON_ERROR)

    # A step

    async def verify(self) -> None:
        await self._start.verify()

    async def go(self, slack_ns: int = 0, sooner_ns: int = 0) -> None:
        # The controller starts itself.
        await self._start.go(sooner_ns)

    async def disarm(self) -> None:
        await self._start.disarm()

    async def started(self) -> Mapping[str, Span]:
        return await self._start.started()

    async def outcome(self) -> Outcome:
        return await self._start.outcome()

    async def stop(self, abort: bool) -> None:
        self._device.stop(abort)

    # Everything else

    async def enable(self, axes: Sequence[str], on: bool) -> None:
        letters = "".join(AXIS_LETTERS[self._motors[name]] for name in axes)
        await self._device.session.tell(("SH" if on else "MO") + letters)
        record = await self._device.record()
        for name in axes:
            if record.axes[self._motors[name]].enabled != on:
                raise CannotDo("enable-failed", f"axis {name} does not switch {'on' if on else 'off'}", "look at TC1")

    async def home(self, axes: Sequence[str], found: Callable[[str], None]) -> Mapping[str, CannotDo]:
        self._jogging.forget(axes)
        searched = [(name, self._motors[name], self._config.axes[name]) for name in axes]
        return await homing.home(self._device, self._clock, searched, found)

    async def jog(self, axis: str, move: JogMove) -> None:
        await self._jogging.jog(axis, move)

    async def stop_axes(self, axes: Sequence[str]) -> None:
        self._device.stop_axes(self._motors[axis] for axis in axes)

    async def load_limits(self, limits: Mapping[str, tuple[int, int] | None]) -> None:
        await load_limits(self._device, self._motors, limits)

    async def set_output(self, number: int, on: bool) -> None:
        await self._device.session.tell(f"{'SB' if on else 'CB'}{number}")

    async def clear_faults(self) -> None:
        # Reading the error code clears it (SMC-4000: L10257; SMC-2000: L11681); all else that a fault leaves behind is
        # cleared by enabling.
        await self._device.session.ask("TC")

    async def raw(self, command: str) -> str:
        return await send_raw(command, self._device.session.ask_all, self._not_by_raw)
