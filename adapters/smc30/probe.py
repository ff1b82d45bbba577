"""A probe: a move to the end of its way with the stop condition N on a user input (L2088-L2147), which decelerates by
its ramp. The controller captures no position: the contact is where it stands, less its ramp.

Never by the Stop input: when that is released, the motion goes on. And only at logic 1, which N takes as a level: of
logic 0 it takes the edge, and one before its motion would be missed.
"""

from contextlib import suppress

from adapters.contract import HostInterval, JogMove, ProbedContact, ProbeMove
from adapters.smc30.hand import ManualRun, Smc30ManualMotion
from adapters.smc30.options import Smc30DriverOptions
from adapters.smc30.session import ControllerBusy
from adapters.smc30.unitstate import Smc30State
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal
from orchestrator.model.state import ProbeAbility

INPUTS = (1, 2, 3)
MARGIN_S = 0.002  # of the interpreter, beyond filter and scan of the inputs
MARGIN_STEPS = 3.0  # the ramp is a whole number of steps, and so are both positions
LOOK_NS = 20 * NS_PER_MS


def find_ability(axis: str, options: Smc30DriverOptions) -> ProbeAbility:
    """Each user input stops the axis, when it becomes logic 1."""
    return ProbeAbility(
        inputs={axis: list(INPUTS)},
        levels=["active", "passive"],
        reaction_s=_reaction_s(options),
        margin_counts=MARGIN_STEPS,
        contact_s=0.0,
        contact_counts=MARGIN_STEPS,
    )


class InputProbe:
    """Probes of one connection."""

    def __init__(self, manual: Smc30ManualMotion, unit: Smc30State, clock: Clock, options: Smc30DriverOptions) -> None:
        self._manual = manual
        self._unit = unit
        self._clock = clock
        self._reaction_s = _reaction_s(options)

    async def run(self, axis: str, move: ProbeMove) -> ProbedContact | None:
        """As `ProbeDriver.probe_axis`. Raises `Refusal`, `ControllerFault`."""
        unit, number, stops = self._unit, move.point.number, self._unit.session.stops
        if not move.level:
            text = f"axis {axis}: an input stops it surely when it becomes logic 1 only"
            raise Refusal("probe-input", text, "invert the signal, or let the computer stop it: `by: host`")
        sign = 1 if move.end_counts >= await unit.require_ready() else -1
        begun_ns = self._clock.now_ns()
        # A jog counts stops from its own begin on.
        unit.session.require_no_stop(stops)
        try:
            await self._manual.start_jog(
                JogMove(sign * move.speed_counts_s, move.ramp_counts_s2, move.end_counts), f"N{number}{number}.91"
            )
            while (await unit.read_status()).busy:
                await sleep_ns(self._clock, LOOK_NS)
        except BaseException:
            with suppress(LinkClosed):
                unit.write_stop("Z")
            raise
        unit.session.require_no_stop(stops)
        run, seen_ns = self._manual.run, self._clock.now_ns()
        assert run is not None
        return await self._find_contact(axis, move, run, HostInterval(begun_ns, seen_ns))

    async def _find_contact(
        self, axis: str, move: ProbeMove, run: ManualRun, span: HostInterval
    ) -> ProbedContact | None:
        unit = self._unit
        try:
            counts = await unit.read_position()
            inputs, _ = await unit.read_points()
        except ControllerBusy:
            raise unit.moving_refusal() from None
        if not inputs[move.point.number]:
            if counts == run.end:
                return None
            text = f"axis {axis} came to rest at {counts} steps, before its end, and its input is not active"
            raise Refusal("probe-broken", text, "the contact was lost again, or a limit switch has stopped it")
        way = run.r + self._reaction_s * move.speed_counts_s + MARGIN_STEPS
        early = counts - run.direction_sign * way
        return ProbedContact(min(early, counts), max(early, counts), span)


def _reaction_s(options: Smc30DriverOptions) -> float:
    return (options.input_filter_us + options.input_poll_us) * 1e-6 + MARGIN_S
