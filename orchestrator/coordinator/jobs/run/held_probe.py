"""Probes of axes that their controllers cannot stop together: a move on a straight line, which the coordinator brakes
as by a feed hold when a state shows that the input has changed, and which is not continued."""

import asyncio
from collections.abc import Awaitable, Callable

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.owner import running
from orchestrator.coordinator.fleet.axis_states import require_axis
from orchestrator.coordinator.jobs.run.motion_chain import MotionChain
from orchestrator.coordinator.jobs.run.run_state import RunState
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.coordinator.motion.negotiation import StartAgreement
from orchestrator.coordinator.motion.start import FEED_HOLD
from orchestrator.coordinator.motion.step import MotionStep
from orchestrator.coordinator.steps.context import StepContext
from orchestrator.coordinator.steps.input_watch import InputWatch
from orchestrator.coordinator.steps.probe import PlannedProbe, plan_probe
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import ProbedAxis, ProbeReply
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.report import JobState, StepReport
from orchestrator.model.state import TimeInterval
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.probe import Probe
from orchestrator.plan.held_probes import LAG_S, LINE_COUNTS, PATH_S, START_SKEW_NS, find_watch_s

REST_COUNTS = 1.0
LOOK_S = 0.05
ACTOR = "probe"

StateChange = Callable[[JobState, str], Awaitable[None]]


class HeldMotion:
    """The motion of one such probe, and what ends it. It is the observer of its motion step.

    agreement: of the members, once the motion is released. t0_ns: T0, fleet time; 0 before. obstacle: why it does not
    begin.
    """

    def __init__(self, motion: MotionStep, watch: InputWatch, state: RunState, change_state: StateChange) -> None:
        self.agreement: StartAgreement | None = None
        self.t0_ns = 0
        self._motion = motion
        self._watch = watch
        self.obstacle: Refusal | None = None
        self._state = state
        self._change_state = change_state

    async def run(self) -> StepReport:
        """Move until the input changes, or is not read in time, or to the end; the report of the motion. Raises
        `Refusal`."""
        watch = self._watch
        async with running(self._motion.run(self, None)) as answer:
            while not answer.done() and not self._is_due:
                watch.woken.clear()
                pause_s = min(LOOK_S, watch.find_unread_s(self.t0_ns)) if self.t0_ns else LOOK_S
                async with running(watch.woken.wait()) as woken:
                    await asyncio.wait([answer, woken], timeout=pause_s, return_when=asyncio.FIRST_COMPLETED)
            await self._hold_when_due()
            return await answer

    @property
    def loss(self) -> str:
        """Why nothing is known of the input; empty: it is read, or nothing moves yet."""
        return self._watch.find_loss(self.t0_ns) if self.t0_ns else ""

    @property
    def _is_due(self) -> bool:
        """Whether the axes are to stop."""
        return self._watch.contact is not None or self.obstacle is not None or bool(self.loss)

    async def _hold_when_due(self) -> None:
        if self._is_due:
            await self._motion.feed_hold(ACTOR)

    async def on_state(self, state: JobState, reason: str) -> None:
        await self._change_state(state, reason)
        if state != "planning":  # there is a motion that can be prevented
            if self._motion.motion is not None and self.obstacle is None:
                self.obstacle = _find_obstacle(self._motion.motion.agreement)
            await self._hold_when_due()

    def on_started(self, t0_fleet_ns: int, duration_s: float) -> None:
        motion = self._motion.motion
        assert motion is not None, "it has started"
        self.agreement, self.t0_ns = motion.agreement, t0_fleet_ns
        self._state.note_start(t0_fleet_ns, duration_s)


class HeldProbes:
    """Runs the probes of a job that the coordinator stops."""

    def __init__(self, services: JobServices, context: StepContext, state: RunState, chain: MotionChain) -> None:
        self._services = services
        self._context = context
        self._state = state
        self._chain = chain

    async def run(self, index: int, step: Probe, change_state: StateChange) -> StepReport:
        """Run step number `index`. Raises `Refusal`, also where nothing was touched and the step does not say `else:
        continue`. change_state: of the job."""
        services, planned_probe = self._services, await plan_probe(self._context, step)
        watch_s, info = (
            find_watch_s(services.view.fleet, step),
            await services.view.infos.require(controller_of(step.until)),
        )
        watch = InputWatch(services.fleet, services.leadership, step, watch_s, shows_moving=info.shows_inputs)
        close_states = await services.view.follow_closely(controller_of(step.until))
        try:
            await watch.require_passive()
            motion_step = self._chain.begin_step(index, _make_move(planned_probe))
            motion = HeldMotion(motion_step, watch, self._state, change_state)
            report = await self._run_motion(motion, watch, step)
            if report.state != "done" and (report.refused is None or report.refused.code != FEED_HOLD):
                return report.model_copy(update={"do": step.kind, "name": step.name or ""})
            await watch.wait_for_reading()
            self._require_read(motion, watch, step)
            probe_report = planned_probe.make_report(*await self._find_contact(planned_probe, motion, watch, report))
        finally:
            watch.close()
            await close_states.undeclare()
            for name in step.axes:
                self._context.targets.forget_target(name)
        update = {"do": step.kind, "name": step.name or "", "state": "done", "reason": "", "refused": None}
        return report.model_copy(update={**update, "probe": probe_report})

    async def _run_motion(self, motion: HeldMotion, watch: InputWatch, step: Probe) -> StepReport:
        try:
            return await motion.run()
        except Refusal as refusal:
            if refusal.code == FEED_HOLD and motion.obstacle is not None:
                raise motion.obstacle from None
            if refusal.code != FEED_HOLD or watch.contact is None:
                raise
            text = f"{step.until} has become {step.level} before anything moved"
            raise Refusal("line-level", text, "probe again", split_name(step.until)[0]) from None

    def _require_read(self, motion: HeldMotion, watch: InputWatch, step: Probe) -> None:
        """Raise `Refusal` where the axes were stopped, or came to their end, without a reading of the input."""
        loss = motion.loss if watch.contact is None else ""
        if loss:
            remedy = "see what delays its controller or the bus, then probe again"
            raise Refusal("probe-broken", f"{loss}: all axes are stopped", remedy, split_name(step.until)[0])

    async def _find_contact(
        self, planned_probe: PlannedProbe, motion: HeldMotion, watch: InputWatch, report: StepReport
    ) -> tuple[ProbeReply, dict[str, ProbedAxis]]:
        contact, view = watch.contact, self._services.view
        probed_axes: dict[str, ProbedAxis] = {}
        for planned_axis in planned_probe.axes:
            state = await require_axis(view, planned_axis.name)
            axis = ProbedAxis(start_counts=planned_axis.start_counts, rest_counts=state.commanded_counts)
            if contact is not None:
                least, most = self._find_counts(planned_axis.name, axis, motion, contact, report)
                axis = axis.model_copy(update={"least_counts": least, "most_counts": most})
            probed_axes[planned_axis.name] = axis
        if contact is None:
            return ProbeReply(), probed_axes
        earliest_ns, latest_ns = contact.earliest_ns, contact.latest_ns
        reply = ProbeReply(touched=True, earliest_ns=earliest_ns, latest_ns=latest_ns, released=watch.released)
        return reply, probed_axes

    def _find_counts(
        self, name: str, probed_axis: ProbedAxis, motion: HeldMotion, contact: TimeInterval, report: StepReport
    ) -> tuple[float, float]:
        """Between what counts an axis was at the contact, by its plan from its start: the plan is followed until the
        stop, which comes behind the contact. A motor is behind its command by its lag."""
        controller, axis_name = split_name(name)
        agreement = motion.agreement
        profile = None if agreement is None else agreement.plan.profiles.get(name)
        if agreement is None or profile is None:
            return probed_axis.start_counts - REST_COUNTS, probed_axis.start_counts + REST_COUNTS
        evidence = report.members[controller].evidence.get(axis_name)
        start = TimeInterval(earliest_ns=motion.t0_ns - START_SKEW_NS, latest_ns=motion.t0_ns + START_SKEW_NS)
        if evidence is not None:
            start = evidence.start_for_verdict
        error = agreement.proposals[controller].path_error_counts.get(axis_name, 0.0) + LINE_COUNTS
        lag = profile.peak_velocity * LAG_S
        times_s = (
            (contact.earliest_ns - start.latest_ns) / NS_PER_S,
            (contact.latest_ns - start.earliest_ns) / NS_PER_S,
        )
        first, last = (profile.start_counts + profile.state_at(max(0.0, time_s)).position for time_s in times_s)
        sign = 1 if profile.end_counts >= profile.start_counts else -1
        ends = first - sign * (error + lag), last + sign * error
        return min(ends), max(ends)


def _find_obstacle(agreement: StartAgreement) -> Refusal | None:
    """An axis that follows its plan less closely than what was stated rests on."""
    for name, profile in agreement.plan.profiles.items():
        controller, axis_name = split_name(name)
        error = agreement.proposals[controller].path_error_counts.get(axis_name, 0.0)
        if error > profile.peak_velocity * PATH_S + LINE_COUNTS:
            speed = f"{profile.peak_velocity:.3g} counts/s"
            text = f"{name} at {speed} would be off its line by {error:.3g} counts, as its controller executes that"
            return Refusal("path-error", text, "probe faster, or with that axis at rest", controller)
    return None


def _make_move(planned_probe: PlannedProbe) -> Move:
    """The move to the end of a probe: on a straight line, with starts that are agreed."""
    step, moving_axes = planned_probe.step, [axis for axis in planned_probe.axes if axis.speed]
    speeds: dict[str, float | str] = {axis.name: f"{axis.speed:.12g} {axis.axis.unit}/s" for axis in moving_axes}
    skew = f"{START_SKEW_NS / NS_PER_MS:g} ms"
    return Move(to=dict(step.to), speed=speeds or 1.0, sync="phase", start="agreed", max_start_skew=skew)
