"""The first chunk of a path, with which its start is negotiated."""

from collections.abc import Mapping
from dataclasses import dataclass

from orchestrator.model.messages import ChunkOptions
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.state import ControllerInfo
from orchestrator.plan.path_clock import PathClock
from orchestrator.plan.path_course import ChunkPlan, PathCourse
from orchestrator.plan.path_step import PlannedPath
from orchestrator.plan.step import StepPlan

LONGEST_CHUNK_S = 7.5  # the drift of a clock in it is not corrected
LEAST_LOAD_S = 1.0  # before the end of a chunk the next one is loaded, or as long before as loading takes
SPARE_LOAD_S = 0.6  # for the exchanges with all members, one more try, and the release


@dataclass(frozen=True, slots=True)
class FirstChunk:
    """The first chunk of a path.

    plan: of the step up to the end of the chunk; members that cannot be continued have the whole path in it. members:
    those that can. most_s: the longest chunk that all of them take. load_s: how long before the end of a chunk the
    loading of the next one begins. clock: of the motion. peaks: largest acceleration and jerk of each axis, counts/s²,
    counts/s³. rate: the feed override wanted; more than 1 is taken on where the axes allow it.
    """

    course: PathCourse
    clock: PathClock
    chunk: ChunkPlan
    plan: StepPlan
    members: frozenset[str]
    most_s: float
    load_s: float
    peaks: tuple[Mapping[str, float], Mapping[str, float]]
    rate: float

    def make_options(self, member: str, chunk: ChunkPlan) -> ChunkOptions:
        """The options of a chunk for one of `members`."""
        own = [axis for axis in self.peaks[0] if controller_of(axis) == member]
        accelerations, jerks = ({split_name(axis)[1]: peaks[axis] for axis in own} for peaks in self.peaks)
        return ChunkOptions(end_s=chunk.end_s, last=chunk.last, peak_accelerations=accelerations, peak_jerks=jerks)

    @property
    def covers_all(self) -> bool:
        """Whether all members can be continued, and so braked along the path."""
        return all(controller_of(axis) in self.members for axis in self.plan.profiles)


def plan_first_chunk(
    path: PlannedPath, whole: StepPlan, infos: Mapping[str, ControllerInfo], begun_s: float, rate: float
) -> FirstChunk | None:
    """Plan the first chunk; None if no member can be continued, and for a line on a trapezoid. infos: by member.
    begun_s: where the motion begins, in the time of the path. rate: the feed override that it begins with. Raises
    `Refusal`, `PlanError`."""
    members = frozenset(member for member, info in infos.items() if info.chunk_s > 0.0)
    course = path.course
    if not members or course is None:
        return None
    most_s = min([LONGEST_CHUNK_S, *(infos[member].chunk_s for member in members)])
    load_s = SPARE_LOAD_S + max([LEAST_LOAD_S, *(infos[member].chunk_load_s for member in members)])
    clock = course.begin_at(begun_s, rate)
    chunk = course.plan_chunk(clock, 0.0, most_s)
    profiles = {
        axis: chunk.profiles[axis] if controller_of(axis) in members else profile
        for axis, profile in whole.profiles.items()
    }
    duration_s = chunk.stop_s if len(members) == len(infos) else whole.duration_s
    plan = StepPlan(duration_s, profiles, whole.unmoved)
    return FirstChunk(
        course=course,
        clock=clock,
        chunk=chunk,
        plan=plan,
        members=members,
        most_s=most_s,
        load_s=min(load_s, most_s),
        peaks=course.find_peaks(),
        rate=rate,
    )
