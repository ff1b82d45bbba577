"""An axis moves until an input changes: one request, which is answered when the axis is at rest."""

import asyncio
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.clock.owner import running
from orchestrator.coordinator.fleet.axis_states import require_axis
from orchestrator.coordinator.steps.context import ReportFields, StepContext
from orchestrator.coordinator.steps.search_requests import SearchRequest
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.messages import ProbeReply, ProbeRequest, raise_first_refusal
from orchestrator.model.names import split_name
from orchestrator.model.report import ProbeReport
from orchestrator.model.state import AxisState, ControllerState, TimeInterval
from orchestrator.model.steps.probe import Probe
from orchestrator.plan.path_step import MAX_START_COUNTS
from orchestrator.plan.play import require_no_play
from orchestrator.plan.probes import ProbeAbilities, find_longest_s, find_overtravel, find_probe_speed, make_other_start
from orchestrator.plan.racks import require_single_motor
from orchestrator.plan.targets import choose_turn, explain_beyond_limits, parse_target
from orchestrator.plan.zones.course import Sweep, Timing

SPARE_S = 5.0  # to begin, to come to rest, and to read


@dataclass(frozen=True, slots=True)
class _PlannedProbe:
    """A probe in counts. begin_counts: where its axis stands. stated_counts: how far it goes on at most."""

    step: Probe
    axis: Axis
    offset: Fraction
    begin_counts: int
    end_counts: int
    speed: float
    stated_counts: float
    longest_s: float

    def make_report(self, reply: ProbeReply) -> ProbeReport:
        """The report of what was found, in user positions."""
        axis, shift = self.axis, float(self.offset)
        ends = sorted(axis.to_unit(counts) for counts in (reply.least_counts, reply.most_counts))
        report = ProbeReport(
            axis=self.step.axis,
            until=self.step.until,
            unit=axis.unit,
            touched=reply.touched,
            start=axis.to_unit(reply.start_counts) + shift,
            rest=axis.to_unit(reply.rest_counts) + shift,
            stated=abs(axis.to_length(self.stated_counts)),
            by=self.step.by,
        )
        if not reply.touched:
            return report
        middle = axis.to_position(Fraction(reply.least_counts + reply.most_counts) / 2)
        return report.model_copy(
            update={
                "least": ends[0] + shift,
                "most": ends[1] + shift,
                "motor": middle,
                "seen": TimeInterval(earliest_ns=reply.earliest_ns, latest_ns=reply.latest_ns),
                "overtravel": abs(axis.to_length(max(self._find_overtravels(reply)))),
                "released": reply.released,
            }
        )

    def exceeds_bound(self, reply: ProbeReply) -> bool:
        """Whether the axis has certainly gone on farther than was stated."""
        return reply.touched and min(self._find_overtravels(reply)) > self.stated_counts

    def _find_overtravels(self, reply: ProbeReply) -> tuple[float, float]:
        sign = 1 if reply.rest_counts >= reply.start_counts else -1
        least, most = reply.least_counts, reply.most_counts
        return max(0.0, sign * (reply.rest_counts - least)), max(0.0, sign * (reply.rest_counts - most))


async def run_probe(context: StepContext, step: Probe) -> ReportFields:
    """Probe; the report states the contact as `probe`. Raises `Refusal`, also where nothing was touched and the step
    does not say `else: continue`."""
    planned_probe = await _plan_probe(context, step)
    await _require_zones(context, planned_probe)
    context.targets.forget_target(step.axis)
    reply = await _send_probe(context, planned_probe)
    raise_first_refusal({split_name(step.axis)[0]: reply})
    report = planned_probe.make_report(reply)
    if planned_probe.exceeds_bound(reply):
        text = f"{step.axis} went on by {report.overtravel:g} {report.unit} behind the contact"
        remedy = "see what delays the controller or its computer; probe more slowly"
        raise Refusal("overtravel", f"{text}, and {report.stated:g} were stated", remedy, split_name(step.axis)[0])
    if not report.touched and step.otherwise == "fail":
        text = f"{step.until} has not become {step.level} up to {report.rest:g} {report.unit} of {step.axis}"
        raise Refusal("not-touched", text, "check the contact and its wire, or go on farther", split_name(step.axis)[0])
    return {"probe": report}


async def _plan_probe(context: StepContext, step: Probe) -> _PlannedProbe:
    view, (controller, _) = context.fleet.view, split_name(step.axis)
    axis, state, info = (
        view.fleet.axis(step.axis),
        await require_axis(view, step.axis),
        await view.require_info(controller),
    )
    require_no_play(step.axis, axis, "contact")
    require_single_motor(step.axis, axis, "probe")
    ability = ProbeAbilities.of(info).require_ability(view.fleet, step)
    speed = find_probe_speed(step, axis)
    await _require_start(context, step)
    target = _find_target(context, step, axis, state)
    end_counts = axis.to_target_counts(target)
    distance = axis.to_length(end_counts - state.commanded_counts)
    longest_s = find_longest_s(axis, distance, speed) + SPARE_S
    stated_counts = find_overtravel(ability, axis, speed)
    begin_counts = state.commanded_counts
    return _PlannedProbe(step, axis, state.offset, begin_counts, end_counts, speed, stated_counts, longest_s)


async def _require_zones(context: StepContext, planned: _PlannedProbe) -> None:
    """Raise `Refusal` for a probe whose axis may bring bodies together anywhere on its way, or by going on behind a
    contact at its end."""
    sign = 1 if planned.end_counts >= planned.begin_counts else -1
    farthest = planned.end_counts + sign * planned.stated_counts
    low, high = sorted(planned.axis.to_unit(counts) for counts in (planned.begin_counts, farthest))
    name = planned.step.axis
    await context.zones.require(Sweep({}, {name: (low, high)}, Timing({}), [name]), context.holder)


async def _require_start(context: StepContext, step: Probe) -> None:
    """Raise `Refusal` for an axis that does not stand where the probe begins, to a count."""
    view = context.fleet.view
    for name, value in step.start.items():
        axis, state = view.fleet.axis(name), await require_axis(view, name)
        begin = parse_target(name, value, axis.unit)
        if abs(axis.to_counts(begin - state.offset) - state.axis_counts) > MAX_START_COUNTS:
            raise make_other_start(name, state.position, begin, axis)


def _find_target(context: StepContext, step: Probe, axis: Axis, state: AxisState) -> Fraction:
    """The motor position where the probe ends. Raises `Refusal`."""
    ((name, value),) = step.to.items()
    amount = parse_target(name, value, axis.unit)
    position_here = context.targets.exact_position(name, state.commanded_counts, axis.to_position(state.axis_counts))
    target = choose_turn(axis, position_here, amount - state.offset, state.offset)
    beyond_limits = explain_beyond_limits(name, axis, target, state.offset)
    if beyond_limits is not None:
        raise Refusal("soft-limit", beyond_limits, "change the target, or the soft limits in the fleet file")
    return target


async def _send_probe(context: StepContext, planned: _PlannedProbe) -> ProbeReply:
    """Send the request, and stop the axis when one of its permits is lost. Raises `Refusal`."""
    step, fleet = planned.step, context.fleet
    controller, axis = split_name(step.axis)
    request = ProbeRequest(
        **context.request_fields,
        axes=[axis],
        holder=context.holder,
        input=None if step.limit is not None else split_name(step.until)[1],
        limit=step.limit,
        active=step.level == "active",
        end_counts=planned.end_counts,
        speed=planned.speed,
        by=step.by,
        overtravel_counts=planned.stated_counts,
    )
    search = SearchRequest(
        controller, "probe", request, ProbeReply, planned.longest_s, lambda state: _moves(state, axis), "probe"
    )
    fleet.permits.require([step.axis])
    guard, woken = fleet.permits.watch_losses([step.axis]), asyncio.Event()
    unlisten = fleet.permits.add_loss_listener(woken.set)
    try:
        async with running(search.send(fleet)) as answer:
            while not answer.done():
                woken.clear()
                async with running(woken.wait()) as loss:
                    await asyncio.wait([answer, loss], return_when=asyncio.FIRST_COMPLETED)
                loss_text = guard.describe_loss()
                if loss_text is not None:
                    await fleet.stop_members([controller], "decelerate", context.actor, loss_text)
                    raise guard.make_refusal("probe")
            return answer.result()
    finally:
        unlisten()


def _moves(state: ControllerState, axis: str) -> bool:
    return state.mode == "moving" or state.axes[axis].moving
