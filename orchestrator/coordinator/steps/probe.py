"""Axes move until an input changes: one request, which is answered when they are at rest."""

import asyncio
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.clock.owner import running
from orchestrator.coordinator.fleet.axis_states import require_axis
from orchestrator.coordinator.fleet.zones import ZoneMover
from orchestrator.coordinator.steps.context import ReportFields, StepContext
from orchestrator.coordinator.steps.search_requests import SearchRequest
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.messages import ProbedAxis, ProbeReply, ProbeRequest, ProbeTerms, raise_first_refusal
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.report import ProbeReport
from orchestrator.model.state import AxisState, ControllerState, TimeInterval
from orchestrator.model.steps.probe import Probe, find_line_ramps
from orchestrator.plan.held_probes import find_ways_to_stop
from orchestrator.plan.path_step import MAX_START_COUNTS
from orchestrator.plan.play import require_no_play
from orchestrator.plan.probes import (
    ProbeAbilities,
    find_longest_s,
    find_most_speeds,
    find_overtravel,
    find_probe_speeds,
    make_other_start,
)
from orchestrator.plan.racks import require_single_motor
from orchestrator.plan.targets import choose_turn, explain_beyond_limits, parse_target
from orchestrator.plan.zones.course import Sweep, Timing

SPARE_S = 5.0  # to begin, to come to rest, and to read


@dataclass(frozen=True, slots=True)
class PlannedProbeAxis:
    """An axis of a probe in counts; speed in its unit/s. start_counts: where it stands. stated_counts: how far it goes
    on at most."""

    name: str
    axis: Axis
    offset: Fraction
    start_counts: int
    end_counts: int
    speed: float
    stated_counts: float

    def find_reach(self) -> tuple[str, tuple[float, float]]:
        """Its name, and between which motor positions it may come, in its unit."""
        sign = 1 if self.end_counts >= self.start_counts else -1
        farthest = self.end_counts + sign * self.stated_counts
        low, high = sorted(self.axis.to_unit(counts) for counts in (self.start_counts, farthest))
        return self.name, (low, high)

    def require_inside(self) -> None:
        """Raise `Refusal` where a contact at the end would bring it beyond its soft limits."""
        side = 1 if self.end_counts >= self.start_counts else -1
        farthest_counts = self.end_counts + side * Fraction(self.stated_counts) * bool(self.speed)
        beyond_limits = explain_beyond_limits(self.name, self.axis, self.axis.to_position(farthest_counts), self.offset)
        if beyond_limits is not None:
            text = f"a contact at the end of the probe: {beyond_limits}"
            raise Refusal("soft-limit", text, "probe more slowly, or less far", split_name(self.name)[0])

    def make_terms(self) -> ProbeTerms:
        """What a request says of it."""
        return ProbeTerms(end_counts=self.end_counts, speed=self.speed, overtravel_counts=self.stated_counts)

    def make_report(self, step: Probe, reply: ProbeReply, probed_axis: ProbedAxis) -> ProbeReport:
        """The report of what was found, in user positions."""
        axis, shift = self.axis, float(self.offset)
        ends = sorted(axis.to_unit(counts) for counts in (probed_axis.least_counts, probed_axis.most_counts))
        report = ProbeReport(
            axis=self.name,
            until=step.until,
            unit=axis.unit,
            touched=reply.touched,
            start=axis.to_unit(probed_axis.start_counts) + shift,
            rest=axis.to_unit(probed_axis.rest_counts) + shift,
            stated=abs(axis.to_length(self.stated_counts)),
            by=step.by,
        )
        if not reply.touched:
            return report
        middle = axis.to_position(Fraction(probed_axis.least_counts + probed_axis.most_counts) / 2)
        return report.model_copy(
            update={
                "least": ends[0] + shift,
                "most": ends[1] + shift,
                "motor": middle,
                "seen": TimeInterval(earliest_ns=reply.earliest_ns, latest_ns=reply.latest_ns),
                "overtravel": abs(axis.to_length(max(_find_overtravels(probed_axis)))),
                "released": reply.released,
            }
        )

    def exceeds_bound(self, probed_axis: ProbedAxis) -> bool:
        """Whether the axis has certainly gone on farther than was stated."""
        return min(_find_overtravels(probed_axis)) > self.stated_counts


def _find_overtravels(probed_axis: ProbedAxis) -> tuple[float, float]:
    sign = 1 if probed_axis.rest_counts >= probed_axis.start_counts else -1
    least, most = probed_axis.least_counts, probed_axis.most_counts
    return max(0.0, sign * (probed_axis.rest_counts - least)), max(0.0, sign * (probed_axis.rest_counts - most))


@dataclass(frozen=True, slots=True)
class PlannedProbe:
    """A probe in counts: its axes, of which the first one moves if any does."""

    step: Probe
    axes: list[PlannedProbeAxis]
    longest_s: float

    @property
    def names(self) -> list[str]:
        """The names of its axes in their controller."""
        return [split_name(planned_axis.name)[1] for planned_axis in self.axes]

    def make_report(self, reply: ProbeReply, probed_axes: Mapping[str, ProbedAxis]) -> ProbeReport:
        """The report of what was found; the first axis of the step has those of the others. Raises `Refusal` where an
        axis has certainly gone on farther than was stated, or where nothing was touched and that fails."""
        reports = {
            planned_axis.name: planned_axis.make_report(self.step, reply, probed_axes[planned_axis.name])
            for planned_axis in self.axes
        }
        first_report, *other_reports = [reports[name] for name in self.step.axes]
        self._require_bounds(reply, reports, probed_axes)
        if not reply.touched and self.step.otherwise == "fail":
            ends = " and ".join(f"{report.rest:g} {report.unit} of {name}" for name, report in reports.items())
            text = f"{self.step.until} has not become {self.step.level} up to {ends}"
            remedy = "check the contact and its wire, or go on farther"
            raise Refusal("not-touched", text, remedy, split_name(self.step.until)[0])
        return first_report.model_copy(update={"others": other_reports})

    def _require_bounds(
        self, reply: ProbeReply, reports: Mapping[str, ProbeReport], probed_axes: Mapping[str, ProbedAxis]
    ) -> None:
        for planned_axis in self.axes:
            if reply.touched and planned_axis.exceeds_bound(probed_axes[planned_axis.name]):
                axis_report = reports[planned_axis.name]
                text = (
                    f"{planned_axis.name} went on by {axis_report.overtravel:g} {axis_report.unit} behind the contact"
                )
                remedy = "see what delays the controller or its computer; probe more slowly"
                controller = split_name(planned_axis.name)[0]
                raise Refusal("overtravel", f"{text}, and {axis_report.stated:g} were stated", remedy, controller)


async def run_probe(context: StepContext, step: Probe) -> ReportFields:
    """Probe; the report states the contact as `probe`. Raises `Refusal`, also where nothing was touched and the step
    does not say `else: continue`."""
    planned_probe = await plan_probe(context, step)
    await _require_zones(context, planned_probe)
    for name in step.axes:
        context.targets.forget_target(name)
    reply, controller = await _send_probe(context, planned_probe), split_name(step.until)[0]
    raise_first_refusal({controller: reply})
    probed_axes = {f"{controller}.{name}": axis for name, axis in reply.list_axes(planned_probe.names).items()}
    return {"probe": planned_probe.make_report(reply, probed_axes)}


async def plan_probe(context: StepContext, step: Probe) -> PlannedProbe:
    """Plan a probe from where its axes stand. Raises `Refusal`."""
    view = context.fleet.view
    axes = {name: view.fleet.axis(name) for name in step.axes}
    states = {name: await require_axis(view, name) for name in axes}
    infos = {member: await view.infos.require(member) for member in map(controller_of, axes)}
    for name, axis in axes.items():
        require_no_play(name, axis, "contact")
        require_single_motor(name, axis, "probe")
    abilities = {member: ProbeAbilities.of(info) for member, info in infos.items()}
    ways_to_stop = find_ways_to_stop(view.fleet, step, axes, abilities, find_most_speeds(step, axes))
    await _require_start(context, step)
    ends = {name: axes[name].to_target_counts(_find_target(context, step, name, states[name])) for name in axes}
    ways = {name: axis.to_length(ends[name] - states[name].commanded_counts) for name, axis in axes.items()}
    speeds = find_probe_speeds(step, axes, ways)
    ramps = find_line_ramps(axes, speeds)
    planned_axes = [
        PlannedProbeAxis(
            name,
            axis,
            states[name].offset,
            states[name].commanded_counts,
            ends[name],
            speeds[name],
            find_overtravel(ways_to_stop[name], axis, speeds[name], ramps[name]),
        )
        for name, axis in sorted(axes.items(), key=lambda item: not ways[item[0]])
    ]
    if step.is_held:  # an adapter does that where it stops the axes
        for planned_axis in planned_axes:
            planned_axis.require_inside()
    longest_s = max(find_longest_s(axis, ways[name], speeds[name]) for name, axis in axes.items())
    return PlannedProbe(step, planned_axes, longest_s + SPARE_S)


async def _require_zones(context: StepContext, planned: PlannedProbe) -> None:
    """Raise `Refusal` for a probe whose axes may bring bodies together anywhere on their way, or by going on behind a
    contact at its end."""
    ends = dict(planned_axis.find_reach() for planned_axis in planned.axes)
    await context.zones.require(Sweep({}, ends, Timing({}), list(ends)), ZoneMover(context.holder))


async def _require_start(context: StepContext, step: Probe) -> None:
    """Raise `Refusal` for an axis that does not stand where the probe begins, to a count."""
    view = context.fleet.view
    for name, value in step.start.items():
        axis, state = view.fleet.axis(name), await require_axis(view, name)
        begin = parse_target(name, value, axis.unit)
        if abs(axis.to_counts(begin - state.offset) - state.axis_counts) > MAX_START_COUNTS:
            raise make_other_start(name, state.position, begin, axis)


def _find_target(context: StepContext, step: Probe, name: str, state: AxisState) -> Fraction:
    """The motor position where an axis of the probe ends. Raises `Refusal`."""
    axis = context.fleet.view.fleet.axis(name)
    amount = parse_target(name, step.to[name], axis.unit)
    position_here = context.targets.exact_position(name, state.commanded_counts, axis.to_position(state.axis_counts))
    target = choose_turn(axis, position_here, amount - state.offset, state.offset)
    beyond_limits = explain_beyond_limits(name, axis, target, state.offset)
    if beyond_limits is not None:
        raise Refusal("soft-limit", beyond_limits, "change the target, or the soft limits in the fleet file")
    return target


async def _send_probe(context: StepContext, planned_probe: PlannedProbe) -> ProbeReply:
    """Send the request, and stop the axes when one of their permits is lost. Raises `Refusal`."""
    step, fleet, names = planned_probe.step, context.fleet, planned_probe.names
    controller = split_name(step.until)[0]
    first, *other_axes = planned_probe.axes
    request = ProbeRequest(
        **context.request_fields,
        axes=names,
        holder=context.holder,
        input=None if step.limit is not None else split_name(step.until)[1],
        limit=step.limit,
        active=step.level == "active",
        end_counts=first.end_counts,
        speed=first.speed,
        by=step.by,
        overtravel_counts=first.stated_counts,
        line={name: other_axis.make_terms() for name, other_axis in zip(names[1:], other_axes, strict=True)},
    )
    search = SearchRequest(
        controller, "probe", request, ProbeReply, planned_probe.longest_s, lambda state: _moves(state, names), "probe"
    )
    fleet.permits.require(step.axes)
    guard, woken = fleet.permits.watch_losses(step.axes), asyncio.Event()
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


def _moves(state: ControllerState, axes: Sequence[str]) -> bool:
    return state.mode == "moving" or any(state.axes[axis].moving for axis in axes)
