"""The position latch of an axis: its own input captures the position within 25 µs (L413, L2536-2592).

The latch of axis X is input 1, and so on; it is fast with a falling edge only (CN, third field -1; L3645). It captures
as soon as it is armed while its input is active.
"""

from collections.abc import Mapping

from adapters.contract import HostInterval, LatchedPosition
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.wire.record import AXIS_LETTERS
from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import DigitalInput
from orchestrator.model.numbers import format_ns

LATCH_INPUTS = (1, 2, 3, 4, 9, 10, 11, 12)
"""By axis, the input of its latch. The SMC-4000 has the first four (L442), an SMC-2000 all (L3041)."""
LATCHES = 4  # of an SMC-4000
LOOK_NS = 20 * NS_PER_MS
FALLING = -1


class PositionLatch:
    """The latches of one controller. motors: by axis, its index. latches: axes that have one. reads_polarity: the
    controller reports CN; otherwise the edge is set (SMC-2000: `CN ?` is refused)."""

    def __init__(
        self,
        device: SmcDevice,
        clock: Clock,
        motors: Mapping[str, int],
        latches: int = LATCHES,
        *,
        reads_polarity: bool = True,
    ) -> None:
        self._latches = latches
        self._reads_polarity = reads_polarity
        self._device = device
        self._clock = clock
        self._motors = motors

    async def take(self, axis: str, point: DigitalInput, within_ns: int) -> LatchedPosition:
        """Arm the latch and wait until it has captured a position. Raises `Refusal`."""
        index, session = self._motors[axis], self._device.session
        letter = AXIS_LETTERS[index]
        await self.require_input(axis, index, point)
        until_ns, armed_ns = self._clock.now_ns() + within_ns, self._clock.now_ns()
        await session.send_command(f"AL{letter}")
        while True:
            (is_armed, counts), answer = await session.read_numbers(f"_AL{letter}", f"_RL{letter}")
            if not is_armed:
                return LatchedPosition(int(counts), HostInterval(armed_ns, answer.received_ns))
            armed_ns = answer.sent_ns
            if self._clock.now_ns() >= until_ns:
                text = f"the latch of axis {axis} has captured nothing within {format_ns(within_ns)}"
                raise Refusal("latch-timeout", text, "check the signal and its wire, or allow more with `timeout`")
            if await self._device.stop_counts.sleep_to_stop(min(LOOK_NS, until_ns - self._clock.now_ns())):
                raise Refusal("stopped", f"a stop came while the latch of axis {axis} was armed", "")

    async def require_input(self, axis: str, index: int, point: DigitalInput) -> None:
        """Raise `Refusal` for an input that does not latch the axis, or is active already."""
        own_number = LATCH_INPUTS[index] if index < self._latches else None
        if point.number != own_number:
            own = "no input" if own_number is None else f"input {own_number}"
            raise Refusal(
                "latch-input",
                f"input {point.number} does not latch axis {axis}; {own} does",
                f"connect the signal to {own}, and name that in the fleet file",
            )
        if point.active != "low":
            raise self._make_polarity(axis, point, FALLING)
        if self._reads_polarity:
            (polarity,), _ = await self._device.session.read_numbers("_CN2")
            if int(polarity) != FALLING:
                raise self._make_polarity(axis, point, polarity)
        else:
            await self._device.session.send_command(f"CN,,{FALLING}")
        record = await self._device.read_record()
        if not record.inputs >> point.number - 1 & 1:
            raise Refusal("line-level", f"input {point.number} is active already", "make it passive before the step")

    def _make_polarity(self, axis: str, point: DigitalInput, polarity: float) -> Refusal:
        return Refusal(
            "latch-input",
            f"the latch of axis {axis} is to take a falling edge: `active: low`, and CN,,-1 in the controller; "
            f"found `active: {point.active}` and CN,,{polarity:.0f}",
            "a rising edge passes its optocoupler 1.5 ms late; invert the signal",
        )
