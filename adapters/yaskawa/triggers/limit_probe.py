"""A probe to a limit switch: the controller itself stops the axis by its deceleration (SMC-4000: L17291-17295).

Nothing is captured, so the contact is within the way that the axis may have gone on, before where it rests.
"""

from adapters.contract import HostInterval, LimitMove, ProbedContact
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.language.words import stop_code_meaning
from adapters.yaskawa.shapes.model import ModelTraits
from adapters.yaskawa.triggers.probe import (
    AT_END,
    LOOK_NS,
    MARGIN_COUNTS,
    RAMP_SHARE,
    REACTION_S,
    ProbeRegisters,
    brake_probe,
    make_stopped,
)
from adapters.yaskawa.wire.record import AXIS_LETTERS
from orchestrator.clock.base import NS_PER_S, NS_PER_US
from orchestrator.model.errors import Refusal
from orchestrator.model.state import ProbeAbility

AT_FORWARD, AT_REVERSE = 2, 3  # stop codes (L9858-9899)
POSITION_COUNTS = 1.0  # by which positions at rest are off


def find_limit_ability(options: YaskawaOptions) -> ProbeAbility:
    """Its switch stops an axis; the isolation of the switches is taken to be that of inputs."""
    opto_s = max(options.input_rise_us, options.input_fall_us) * NS_PER_US / NS_PER_S
    return ProbeAbility(
        inputs={},
        levels=["active"],
        reaction_s=REACTION_S + opto_s + 2 * options.tick_ns / NS_PER_S,
        ramp_share=RAMP_SHARE,
        margin_counts=MARGIN_COUNTS,
        contact_s=0.0,
        contact_counts=POSITION_COUNTS,
    )


class LimitProbe:
    """A probe of one axis. index: of its motor. ability: what is stated of its limit switches."""

    def __init__(self, device: SmcDevice, model: ModelTraits, ability: ProbeAbility, index: int) -> None:
        self._device = device
        self._model = model
        self._ability = ability
        self._index = index
        self._letter = AXIS_LETTERS[index]

    async def run(self, axis: str, move: LimitMove) -> ProbedContact | None:
        """As `LimitProbeDriver.probe_limit`. Raises `Refusal`, `ControllerFault`."""
        try:
            return await self._run(axis, move, self._device.stop_counts.stop_count(self._index))
        except BaseException:
            brake_probe(self._device, self._index)
            raise

    async def _run(self, axis: str, move: LimitMove, stops: int) -> ProbedContact | None:
        device, letter = self._device, self._letter
        registers = ProbeRegisters.find(axis, move, device.samples.tick_ns * 1e-9, self._model)

        def require_no_stop() -> None:
            device.stop_counts.require_no_stop(axis, self._index, stops)

        async with device.exclusive_turn():
            commands = (*registers.list_commands(letter), f"PA{letter}={move.end_counts}")
            await device.session.send_settings(commands, require_no_stop)
            record = await device.read_record()
            begin_ns, sign = record.sent_ns, 1 if move.end_counts >= record.axes[self._index].commanded else -1
            await device.begin_motion(axis, self._index, stops)
        moving_ns = begin_ns
        while True:
            record, (code,) = await device.read_record_with(f"_SC{letter}")
            state = record.axes[self._index]
            if not state.is_moving:
                break
            if not state.is_stopping:
                moving_ns = record.sent_ns
            if await device.stop_counts.sleep_to_stop(LOOK_NS):
                raise make_stopped(axis)
        if int(code) == AT_END:
            return None
        if int(code) != (AT_FORWARD if sign > 0 else AT_REVERSE):
            meaning = stop_code_meaning(int(code))
            raise Refusal("probe-broken", f"axis {axis}: the probe {meaning.text}", meaning.remedy)
        # What is read at rest may be off by as much.
        way = self._ability.find_overtravel(move.speed_counts_s, move.ramp_counts_s2) - POSITION_COUNTS
        early, late = state.commanded - sign * way, state.commanded + sign * POSITION_COUNTS
        # The switch was pressed before the controller showed it, by its isolation and a sample.
        pressed_ns = moving_ns - round(self._ability.reaction_s * NS_PER_S)
        return ProbedContact(min(early, late), max(early, late), HostInterval(pressed_ns, record.received_ns))
