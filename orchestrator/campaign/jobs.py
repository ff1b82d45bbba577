"""Jobs of the fault campaign: one that the fault affects, one that runs at the same time, one that waits for both."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import chain
from random import Random
from typing import Any, Literal, NamedTuple

from orchestrator.campaign.fleets import PATH_MAKE
from orchestrator.campaign.stages.fleet_parts import TRIGGER_OUTPUT, TRIGGER_PERIOD, find_traits
from orchestrator.campaign.stages.flown_scans import draw_flown_scan
from orchestrator.campaign.stages.hall import is_hall, name_groups
from orchestrator.campaign.stages.pairs import find_paired_controllers, move_pairs_as_one
from orchestrator.campaign.stages.probes import draw_probe
from orchestrator.campaign.stages.virtual_moves import VIRTUAL_SPEED, draw_virtual_targets
from orchestrator.campaign.stages.zones import draw_zone_jobs, find_way_back
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.fleet import Fleet, group_by_link
from orchestrator.model.jobs.job import Job
from orchestrator.model.names import controller_of
from orchestrator.model.queue import QueueTerms
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.live import Live
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.triggers import Trigger
from orchestrator.model.steps.wait_armed import WaitArmed

SPEED_FRACTION = 0.17  # of the speed limits: no axis reaches its target before the fault
WITNESS = "witness"  # of a fleet that works again
WITNESS_SHARE = 0.2  # of the way of other moves
DWELL_CHANCE = 0.25
CHAIN_STEPS = 4
CHAIN_SHARE = 0.7  # of the other controllers in a step of a chain
CHAIN_MOVE_S = (0.8, 1.3)  # of a move in a chain at that speed, without its ramps, to and from near its beginning
CHAIN_BACK_S = (0.0, 0.15)
PATH_SHARES = (0.4, 1.0, 0.5, 0.1)  # of the way of a move, at the end of each line
PATH_TOLERANCE = 8.0  # units: the clocks of a campaign's fleet are young
ARMED_TIMEOUT = "30 s"  # of a step that waits armed
ZONE_END_SKEW_NS = 300 * NS_PER_MS  # between both carriages
MAX_MOVE_S = 5.5  # of a move: some seconds more than injecting and detecting the fault takes
HALL_MOVE_S = 3.0  # the same where each second of motion is one of 200 controllers


MainKind = Literal[
    "move", "home", "chain", "path", "trigger", "at-once", "live", "armed", "flight", "virtual", "pair", "probe", "zone"
]
"""home: `member` is homed before the move. chain: several steps, one after the other. path: one step along a path of
several chunks. trigger: outputs are switched on the way. at-once: a chain of `member` alone, whose steps start at
once. live: a live job whose program asks for a chain. armed: its move waits
armed for a request. flight: a scan that flies. virtual: its move is one of virtual axes. pair: its move is that of a
pair. probe: `member` probes, and goes back.
zone: jobs of axes that carry bodies of keep-out zones."""


@dataclass(frozen=True, slots=True)
class JobOrder:
    """A job to submit, with its queue terms. controllers: those that it moves. asked_steps: of a live job, what its
    program asks for."""

    job: Job
    terms: QueueTerms
    controllers: tuple[str, ...]
    asked_steps: tuple[Step, ...] = ()


def find_longest_move_s(fleet: Fleet) -> float:
    """The longest time that moves of a fleet take, s."""
    return HALL_MOVE_S if is_hall(fleet) else MAX_MOVE_S


def make_job(fleet: Fleet, name: str, steps: Sequence[dict[str, Any]]) -> Job:
    """Return a job with a loose end skew limit; the axes of a pair are named by the pair.

    After a failed job an axis may have only a short distance to go while others move for seconds, and its controller
    may not support so low a speed: it may end that much earlier."""
    plain = {"schema": "tutti.job/1", "name": name, "max_start_skew": "150 ms", "max_end_skew": "7 s"}
    return Job.model_validate({**plain, "steps": move_pairs_as_one(fleet, steps)})


def make_preparation(fleet: Fleet, axes: list[str], homing: list[str]) -> Job:
    """Return a job that enables axes, and homes some of them."""
    homing = name_groups(fleet, homing) if is_hall(fleet) else homing
    steps: list[dict[str, Any]] = [{"do": "enable", "axes": axes}]
    return make_job(fleet, "prepare", steps + ([{"do": "home", "axes": homing}] if homing else []))


def draw_orders(
    fleet: Fleet,
    member: str,
    positions: Mapping[str, float],
    draw: Random,
    kind: MainKind = "move",
) -> list[JobOrder]:
    """Draw two or three jobs; the first one, of this kind, moves `member`. positions: position of each axis, in its
    unit."""
    if kind == "zone":
        return _draw_zone_orders(fleet, member, positions, draw)
    groups = [line for line in _group_inseparable(fleet) if member not in line]
    draw.shuffle(groups)
    group_count = max(1, len(groups) - draw.choice((0, 1, 2)))
    main = sorted([*_find_inseparable(fleet, member), *chain(*groups[:group_count])])
    other_controllers = sorted(chain(*groups[group_count:]))
    all_positions = dict(positions)
    first: list[dict[str, Any]] = []
    if kind == "home":
        first = [{"do": "home", "axes": [member]}]
        all_positions |= {f"{member}.{axis}": 0.0 for axis in fleet.controllers[member].axes}
    main = _find_main(fleet, member, kind) or main
    other_controllers = [name for name in other_controllers if name not in main]
    job = _draw_main(kind, _JobAxes(fleet, main, all_positions), member, draw, first)
    orders = [_make_live(job, main) if kind == "live" else JobOrder(job, QueueTerms(), tuple(main))]
    if other_controllers:
        terms = QueueTerms(repeat=draw.choice((1, 2)), priority=draw.choice((0, 5)))
        orders.append(
            JobOrder(
                _draw_moves("beside", _JobAxes(fleet, other_controllers, all_positions), draw),
                terms,
                tuple(other_controllers),
            )
        )
    late = sorted(chain(*draw.sample(_group_inseparable(fleet), 2)))
    terms = QueueTerms(priority=draw.choice((-1, 0)))
    orders.append(JobOrder(_draw_moves("late", _JobAxes(fleet, late, all_positions), draw), terms, tuple(late)))
    return orders


def _find_main(fleet: Fleet, member: str, kind: MainKind) -> list[str]:
    """The controllers of the first job, where its kind says which; else none."""
    match kind:
        case "at-once" | "probe":
            return [member]
        case "pair":
            return find_paired_controllers(fleet)
        case "path" | "flight":
            return [name for name in fleet.controllers if _takes_paths(fleet, name)]
        case "virtual":
            return list(fleet.controllers)
        case _:
            return []


def _draw_zone_orders(fleet: Fleet, member: str, positions: Mapping[str, float], draw: Random) -> list[JobOrder]:
    """Axes of one step arrive together, so that what they may be apart in time leaves them room."""
    return [
        JobOrder(
            make_job(fleet, job.name, job.steps).model_copy(update={"max_end_skew": ZONE_END_SKEW_NS}),
            job.terms,
            tuple(dict.fromkeys(map(controller_of, job.axes))),
        )
        for job in draw_zone_jobs(fleet, member, positions, draw)
    ]


def _make_live(job: Job, controllers: list[str]) -> JobOrder:
    """A live job whose program asks for the steps of `job`."""
    live_job = job.model_copy(update={"steps": [Live(axes=controllers)]})
    return JobOrder(live_job, QueueTerms(), tuple(controllers), tuple(job.steps))


def _draw_main(
    kind: MainKind, axes: "_JobAxes", member: str, draw: Random, steps_before: Sequence[dict[str, Any]]
) -> Job:
    """Draw the job of `member`."""
    if kind == "path":
        return _draw_path("main", axes, draw)
    if kind == "flight":
        return make_job(
            axes.fleet, "main", [draw_flown_scan(axes.fleet, axes.controllers, member, axes.positions, draw)]
        )
    if kind in ("chain", "at-once", "live"):
        return _draw_chain("main", axes, member, draw, alone=kind == "at-once")
    if kind == "virtual":
        targets = draw_virtual_targets(axes.fleet, axes.positions, draw)
        return make_job(axes.fleet, "main", [{"do": "move", "to": targets, "speed": VIRTUAL_SPEED}])
    if kind == "probe":
        return make_job(axes.fleet, "main", draw_probe(axes.fleet, member, axes.positions, draw))
    if kind == "pair":
        targets = _draw_targets(axes.fleet, axes.controllers, axes.positions, draw)
        axes.positions.update(targets)
        paired_targets = {name: targets[name] for name in axes.fleet.virtual_axes.pair_of}
        return make_job(axes.fleet, "main", [{"do": "move", "to": paired_targets, "speed": SPEED_FRACTION}])
    job = _draw_moves("main", axes, draw, steps_before)
    if kind == "armed":
        return _let_wait(job)
    return _add_triggers(job, axes.fleet, axes.controllers) if kind == "trigger" else job


def _let_wait(job: Job) -> Job:
    """The job with a wait before its move, which starts by no line."""
    steps: list[Any] = []
    for step in job.steps:
        if step.is_motion:
            steps.append(WaitArmed(timeout=ARMED_TIMEOUT))
            step = step.model_copy(update={"start": "auto"})
        steps.append(step)
    return job.model_copy(update={"steps": steps})


def make_trial(fleet: Fleet, member: str, priority: int = 9) -> JobOrder:
    """Return a job, of the highest priority by default, that enables, homes and moves one controller."""
    paired_controllers = find_paired_controllers(fleet)
    controllers = paired_controllers if member in paired_controllers else [member]
    targets = {
        f"{controller}.{name}": axis.limits.velocity * SPEED_FRACTION
        for controller in controllers
        for name, axis in fleet.controllers[controller].axes.items()
    }
    steps: list[dict[str, Any]] = [{"do": "enable", "axes": controllers}, {"do": "home", "axes": controllers}]
    job = make_job(fleet, "try", [*steps, {"do": "move", "to": targets, "speed": SPEED_FRACTION}])
    return JobOrder(job, QueueTerms(priority=priority), tuple(controllers))


def make_witness(fleet: Fleet, positions: Mapping[str, float], attempt: int) -> JobOrder:
    """Return a short move of all controllers, after all other jobs. positions: of each axis, in its unit. attempt:
    every second one goes the other way, which moves an axis off a limit switch."""
    targets: dict[str, float] = {}
    for name, position in positions.items():
        reach = fleet.axis(name).limits.velocity * SPEED_FRACTION * find_longest_move_s(fleet)
        forward = (position < reach / 2) != bool(attempt % 2)
        way_back = find_way_back(fleet, name, position)
        share = WITNESS_SHARE * (reach if forward else -reach)
        targets[name] = round(position + share, 2) if way_back is None else way_back
    job = make_job(fleet, WITNESS, [{"do": "move", "to": targets, "speed": SPEED_FRACTION}])
    return JobOrder(job, QueueTerms(priority=-9), tuple(fleet.controllers))


def _group_inseparable(fleet: Fleet) -> list[list[str]]:
    """Group controllers that move in one job or not at all, because one broadcast starts all loaded moves on a link, or
    they carry one beam."""

    def start_together(line: list[str]) -> bool:
        return find_traits(fleet.controllers[line[0]].adapter).starts_link_together

    lines = [line for line in group_by_link(fleet.controllers) if start_together(line)]
    paired_controllers = set(find_paired_controllers(fleet))
    paired_lines = [line for line in lines if paired_controllers & set(line)]
    if paired_controllers:
        beam_line = paired_controllers.union(*paired_lines)
        lines = [line for line in lines if line not in paired_lines]
        lines.append([name for name in fleet.controllers if name in beam_line])
    drives = {name for line in lines for name in line}
    return lines + [[name] for name in fleet.controllers if name not in drives]


def _find_inseparable(fleet: Fleet, member: str) -> list[str]:
    return next(names for names in _group_inseparable(fleet) if member in names)


class _JobAxes(NamedTuple):
    """What a job moves. positions: of each axis, in its unit; updated by every job that is drawn."""

    fleet: Fleet
    controllers: list[str]
    positions: dict[str, float]


def _draw_moves(name: str, axes: _JobAxes, draw: Random, steps_before: Sequence[dict[str, Any]] = ()) -> Job:
    """Draw a job with a move. steps_before: steps before the move."""
    fleet, controllers, positions = axes
    targets = _draw_targets(fleet, controllers, positions, draw)
    positions |= targets
    steps: list[dict[str, Any]] = [
        {"do": "move", "to": targets, "speed": SPEED_FRACTION, **_draw_start_options(fleet, controllers, draw)}
    ]
    if draw.random() < DWELL_CHANCE:
        steps.insert(0, {"do": "dwell", "duration": f"{draw.randrange(300)} ms"})
    return make_job(fleet, name, [*steps_before, *steps])


def _draw_chain(name: str, axes: _JobAxes, member: str, draw: Random, *, alone: bool) -> Job:
    """Draw a job of short moves, one after the other, all of `member` and most of the others; some with a dwell in
    between. alone: of `member` alone, and they start at once."""
    steps: list[dict[str, Any]] = []
    groups = [[member]] if alone else _find_groups(axes)
    options = {"start": "at_once"} if alone else {}
    begins = dict(axes.positions)
    for number in range(CHAIN_STEPS):
        share = draw.uniform(*(CHAIN_BACK_S if number % 2 else CHAIN_MOVE_S))
        moved_groups = [group for group in groups if member in group or not number or draw.random() < CHAIN_SHARE]
        targets: dict[str, float] = {}
        for axis in (
            f"{controller}.{axis}"
            for controller in chain(*moved_groups)
            for axis in axes.fleet.controllers[controller].axes
        ):
            reach = axes.fleet.axis(axis).limits.velocity * SPEED_FRACTION
            way = reach if begins[axis] < reach * find_longest_move_s(axes.fleet) / 2 else -reach
            targets[axis] = round(begins[axis] + way * share, 2)
        axes.positions.update(targets)
        steps.append({"do": "move", "to": targets, "speed": SPEED_FRACTION, **options})
        if draw.random() < DWELL_CHANCE:
            steps.append({"do": "dwell", "duration": f"{draw.randrange(300)} ms"})
    return make_job(axes.fleet, name, steps)


def _find_groups(axes: _JobAxes) -> list[list[str]]:
    """The inseparable groups among the controllers of a job."""
    return [group for group in _group_inseparable(axes.fleet) if set(group) <= set(axes.controllers)]


def _takes_paths(fleet: Fleet, name: str) -> bool:
    config = fleet.controllers[name]
    return config.adapter == PATH_MAKE or all(axis.limits.jerk for axis in config.axes.values())


def _draw_path(name: str, axes: _JobAxes, draw: Random) -> Job:
    """Draw a job of one path to and fro, of the first axis of each controller: lines, for some chunks. Corners on the
    way out are rounded."""
    moved_axes = [
        f"{controller}.{next(iter(axes.fleet.controllers[controller].axes))}" for controller in axes.controllers
    ]
    speed = min(axes.fleet.axis(axis).limits.velocity for axis in moved_axes) * SPEED_FRACTION
    reach = speed * MAX_MOVE_S
    positions = [axes.positions[axis] for axis in moved_axes]
    ways = [reach if position < reach / 2 else -min(reach, position) for position in positions]
    points = [
        [
            round(axes.positions[axis] + way * share * draw.uniform(0.9, 1.0), 2)
            for axis, way in zip(moved_axes, ways, strict=True)
        ]
        for share in PATH_SHARES
    ]
    pieces = [{"piece": "line", "to": point, "corner": {"within": 0.3}} for point in points]
    start = [round(axes.positions[axis], 6) for axis in moved_axes]
    path = {
        "do": "path",
        "axes": moved_axes,
        "start": start,
        "pieces": pieces,
        "speed": speed,
        "tolerance": PATH_TOLERANCE,
    }
    axes.positions.update(dict(zip(moved_axes, points[-1], strict=True)))
    return make_job(axes.fleet, name, [path])


def _add_triggers(job: Job, fleet: Fleet, controllers: Sequence[str]) -> Job:
    """The job with triggers of all controllers that have an output for them; it starts by their clocks, and all axes
    end together, so that an output is not switched longer than its controller moves."""
    outputs = [f"{name}.{TRIGGER_OUTPUT}" for name in controllers if TRIGGER_OUTPUT in fleet.controllers[name].outputs]
    triggers = [Trigger(output=output, every=TRIGGER_PERIOD) for output in outputs]
    steps = [
        step.model_copy(update={"triggers": triggers, "start": "auto", "sync": "time"})
        if isinstance(step, Move)
        else step
        for step in job.steps
    ]
    return job.model_copy(update={"steps": steps})


def _draw_targets(
    fleet: Fleet, controllers: list[str], positions: Mapping[str, float], draw: Random
) -> dict[str, float]:
    """Draw targets: moves of some seconds to and fro within the soft limits."""
    axes = [f"{name}.{axis}" for name in controllers for axis in fleet.controllers[name].axes]
    targets: dict[str, float] = {}
    for axis in axes:
        reach = fleet.axis(axis).limits.velocity * SPEED_FRACTION * find_longest_move_s(fleet)
        is_far = positions[axis] < 0.5 * reach
        targets[axis] = round(reach * (draw.uniform(0.75, 1.0) if is_far else draw.uniform(0.0, 0.25)), 2)
    return targets


def _draw_start_options(fleet: Fleet, controllers: list[str], draw: Random) -> dict[str, Any]:
    """Draw how the move is synchronised and started, among the options that the makes support."""
    chance = draw.random()
    makes = {fleet.controllers[name].adapter for name in controllers}
    waiting_targets = {connection.target for connection in fleet.connections} & set(controllers)
    if chance < 0.15:
        return {"sync": "none"}
    if chance < 0.3:
        return {"sync": "phase"}
    if chance < 0.55 and waiting_targets:
        return {"start": "line"}
    classes = {find_traits(make).start_class for make in makes}
    if chance < 0.65 and classes == {"host"}:
        return {"start": "host"}
    if chance < 0.75 and classes in ({"clock"}, {"sync"}):
        return {"start": classes.pop()}
    return {}


def find_link_members(fleet: Fleet, member: str) -> list[str]:
    """Return the controllers on the link of `member`, the first one included."""
    return next(names for names in group_by_link(fleet.controllers) if member in names)
