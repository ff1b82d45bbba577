"""The rest of a job: of a path from where it stood, of a scan from its point, of others from their step."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from fractions import Fraction

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.rest import AxisWay, JobRest
from orchestrator.model.names import controller_of
from orchestrator.model.queue import MAX_STEPS
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.order import StepPlace
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.scan import Scan
from orchestrator.model.steps.tree import as_path, iterate_steps
from orchestrator.model.units import Unit, parse_quantity
from orchestrator.plan.continuing.ended_job import EndedJob, LastStep, find_last_step
from orchestrator.plan.continuing.outputs import find_switches
from orchestrator.plan.continuing.path_place import StoodPath, find_start_by_axis, find_stood_path
from orchestrator.plan.path.rest import DIGITS, cut_path
from orchestrator.plan.virtual_moves import find_virtual_names

MAX_DESCRIBED_STEPS = 20
WHOLE = "run the whole step again: `tutti job retry`"
BY_PRESENT = "by where the axes are now: the job kept no recording of its last motion"


def find_job_rest(ended: EndedJob) -> JobRest:
    """What is left of a job, and the way back to where it stood. Raises `Refusal`, with why it cannot go on there."""
    if ended.job.is_open:
        text = "it was a live job: its moves came from a program, and are not kept"
        raise Refusal("live", text, "run that program again")
    last = find_last_step(ended)
    switches = find_switches(ended.job.steps, ended.report.repeat, last.place.index, ended.outputs)
    if last.place.scan is not None:
        return _find_scan_rest(ended, last.place, last.place.scan, switches)
    return _find_step_rest(ended, last, switches)


def _find_step_rest(ended: EndedJob, last: LastStep, switches: Sequence[Step]) -> JobRest:
    left_steps = [step.step for step in ended.order.list_remaining(last.place.index)]
    if len(left_steps) + len(switches) > MAX_STEPS:
        text = f"what is left are {len(left_steps)} steps; the maximum of a job is {MAX_STEPS}"
        raise Refusal("too-long", text, WHOLE)
    _require_probes(left_steps)
    job_rest = describe_rest(ended, last.place, switches, left_steps)
    path = as_path(left_steps[0])
    if path is not None:
        is_recorded = last.is_under_way and ended.recording is not None
        left_steps[0], cut = _cut(find_stood_path(ended, path, is_recorded=is_recorded))
        words = f"{job_rest.place}{cut.words}" + ("" if is_recorded else f", {BY_PRESENT}")
        changes = {"place": words, "piece": cut.piece, "line": cut.line, "is_recorded": is_recorded}
        job_rest = job_rest.model_copy(update=changes)
    way = find_way(ended, find_first_places(ended, left_steps))
    job = ended.job.model_copy(update={"name": _name(ended.job, "rest of"), "steps": [*switches, *left_steps]})
    return job_rest.model_copy(update={"way": way, "move": make_move(ended.job, way), "job": job})


def _require_probes(left_steps: Sequence[Step]) -> None:
    """Raise `Refusal` where the probe of a measured target is not among what is left."""
    contact_names: set[str] = set()
    for step in iterate_steps(left_steps):
        for name in [name for target in step.measured_targets.values() for name in target.of]:
            if name not in contact_names:
                text = f"what is left goes by {name}, which was measured before: {step.describe()}"
                raise Refusal("measured", text, "run it again from its probe on: `tutti job retry JOB --step N`")
        contact_names.update(step.contact_names)


@dataclass(frozen=True, slots=True)
class _PathCut:
    """Where a path was cut, in words, and by piece and line, from 1."""

    words: str
    piece: int | None = None
    line: int | None = None


def _cut(stood: StoodPath) -> tuple[FollowPath, _PathCut]:
    """The rest of a path, and where it begins."""
    step, path_place = stood.step, stood.place
    if path_place is None:
        return step, _PathCut(", at its start")
    words = f", piece {path_place.piece + 1} of {len(step.pieces)}"
    line = None if step.source is None else step.source.find_line(path_place.piece)
    if line is not None and step.source is not None:
        words += f", line {line} of {step.source.file}"
    if path_place.piece == 0 and path_place.along == 0.0:
        return step, _PathCut(f"{words}, at its start", 1, line)
    return cut_path(step, stood.path, path_place, stood.units), _PathCut(words, path_place.piece + 1, line)


def _find_scan_rest(ended: EndedJob, place: StepPlace, scan: Scan, switches: Sequence[Step]) -> JobRest:
    """A scan goes on with the whole of its point: its points and their numbers stay, as in a re-run."""
    assert place.point is not None
    job_rest = describe_rest(ended, place, switches, [scan])
    target = _find_point(ended, place, scan)
    way = find_way(ended, target)
    changes: dict[str, object] = {"point": place.point + 1, "retry_step": place.first}
    if not target:
        changes["place"] = f"{job_rest.place}; where that is only its table says"
    if switches:
        changes["switch"] = ended.job.model_copy(
            update={"name": _name(ended.job, "outputs of"), "steps": list(switches), "parameters_used": {}}
        )
    return job_rest.model_copy(update={**changes, "way": way, "move": make_move(ended.job, way)})


def _find_point(ended: EndedJob, place: StepPlace, scan: Scan) -> dict[str, Fraction]:
    """The positions of a point, by axis, in their units; none of a table that the coordinator keeps, and of which that
    point was not recorded."""
    number, record = place.point or 0, ended.point
    names = scan.axis_names
    if virtual_names := find_virtual_names(ended.fleet, scan):
        text = f"{scan.describe()} depends on where the real axes of {', '.join(virtual_names)} stood"
        raise Refusal("relative", text, "move them to where it began, then `tutti job retry` from its step")
    units = [Unit(ended.fleet.axis(name).unit) for name in names]
    if record is not None and (record.step, record.point) == (place.first, number + 1):
        return {name: Fraction(str(value)) for name, value in record.target.items()}
    if scan.axes:
        return dict(zip(names, scan.grid.find_position(number, units), strict=True))
    rows = None if scan.points is None else scan.points.rows
    if rows is None:
        return {}
    values = zip(rows[number], units, names, strict=True)
    return dict(zip(names, [parse_quantity(value, unit, name) for value, unit, name in values], strict=True))


def find_first_places(ended: EndedJob, left_steps: Sequence[Step]) -> dict[str, Fraction]:
    """Where the first motion of what is left begins, if it is a path, or goes, if it is a move; none for others. Raises
    `Refusal` for a move by a distance."""
    for step in iterate_steps(left_steps):
        path = as_path(step)
        if path is not None:
            return find_start_by_axis(path, ended.fleet)
        # Virtual axes that a step does not name keep their positions, so where it goes depends on where it began.
        relative_axes = [*step.relative_axes, *find_virtual_names(ended.fleet, step)]
        if relative_axes:
            axes = ", ".join(dict.fromkeys(relative_axes))
            text = f"{step.describe()}, which is left, depends on where {axes} stood, and that is not known"
            raise Refusal("relative", text, "move the axes to where it began, then `tutti job retry` from its step")
        if step.is_motion:
            pairs = step.iterate_targets()
            return {name: parse_quantity(target, ended.fleet.axis(name).unit, name) for name, target in pairs}
        if step.moves:
            break
    return {}


def find_way(ended: EndedJob, targets: Mapping[str, Fraction]) -> list[AxisWay]:
    """The way of all axes of a place, if one of them is elsewhere. Raises `Refusal` for one that is not known."""
    way: list[AxisWay] = []
    is_elsewhere = False
    for name, target in targets.items():
        axis, axis_now = ended.fleet.axis(name), ended.axes.get(name)
        if axis_now is None:
            text = f"where {name} is cannot be known: its controller is offline"
            raise Refusal("offline", text, "check its power and cable", controller_of(name))
        if axis_now.referenced is False:
            text = f"{name} has lost its reference, so that its way back is not known"
            name_whole = ended.fleet.virtual_axes.name_whole(name)
            raise Refusal("not-referenced", text, f"home it first: `tutti axis home {name_whole}`", controller_of(name))
        present_position = axis_now.motor + axis_now.offset
        is_elsewhere = is_elsewhere or abs(target - present_position) * abs(axis.counts_per_unit) > 1
        way.append(AxisWay(axis=name, unit=Unit(axis.unit), here=float(present_position), to=float(target)))
    return _join_pairs(ended.fleet, way) if is_elsewhere else []


def _join_pairs(fleet: Fleet, way: list[AxisWay]) -> list[AxisWay]:
    """The way with the middles of pairs in the place of their axes, which do not move alone."""
    for pair in fleet.virtual_axes.pairs.values():
        parts = {part.axis: part for part in way if part.axis in pair.real}
        if len(parts) < len(pair.real):
            continue
        virtual_map = fleet.virtual_axes.maps[pair.group]
        ends = ([parts[axis].here for axis in pair.real], [parts[axis].to for axis in pair.real])
        begin, end = (virtual_map.observe(positions)[0] for positions in ends)
        way = [
            *(part for part in way if part.axis not in parts),
            AxisWay(axis=pair.middle, unit=pair.unit, here=begin, to=end),
        ]
    return way


def make_move(job: Job, way: Sequence[AxisWay]) -> Job | None:
    """The job that takes the axes back: straight and together, at the speed for work by hand."""
    if not way:
        return None
    targets = {axis.axis: f"{axis.to:.{DIGITS}g} {axis.unit}" for axis in way}
    move = Move(to=targets, speed="manual", sync="phase")
    return Job(_name(job, "back for"), [move], actor=job.actor)


def describe_rest(ended: EndedJob, place: StepPlace, switches: Sequence[Step], left_steps: Sequence[Step]) -> JobRest:
    """The rest as far as it is the same for all kinds of steps."""
    steps = [step.describe() for step in (*switches, *left_steps)]
    return JobRest(
        continues=ended.report.job_id,
        name=ended.report.name,
        place=place.describe(),
        step=place.index,
        outputs={output: level for step in switches for output, level in step.left_levels.items()},
        confirm=[f"job {entry.id} goes on with it already, and is {entry.state}" for entry in ended.rests],
        steps=steps[:MAX_DESCRIBED_STEPS],
    )


def _name(job: Job, words: str) -> str:
    """A name that says what the job is for; once, however often it was continued."""
    return f"{words} {job.name.removeprefix('rest of ')}"[:120]
