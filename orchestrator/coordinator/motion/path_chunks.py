"""The first chunk of a path, with which its start is negotiated."""

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.motion.planning import PlannedStep
from orchestrator.coordinator.switching.outputs import find_own_axis
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import ChunkOptions, OutputTrigger
from orchestrator.model.names import controller_of, split_name
from orchestrator.model.state import ChunkTriggers, ControllerInfo
from orchestrator.plan.flying.path import ChunkAbility
from orchestrator.plan.path_clock import PathClock
from orchestrator.plan.path_course import ChunkPlan, PathCourse
from orchestrator.plan.path_triggers import GivenTrigger, PathTrigger
from orchestrator.plan.step import StepPlan

LONGEST_CHUNK_S = 7.5  # the drift of a clock in it is not corrected
LEAST_LOAD_S = 1.0  # before the end of a chunk the next one is loaded, or as long before as loading takes
SPARE_LOAD_S = 0.6  # for the exchanges with all members, one more try, and the release


@dataclass(frozen=True, slots=True)
class FirstChunk:
    """The first chunk of a path.

    plan: of the step up to the end of the chunk; members that cannot be continued have the whole path in it. members:
    those that can, with the owners of outputs that are switched on the way. most_s: the longest chunk that all of them
    take. load_s: how long before the end of a chunk the loading of the next one begins. clock: of the motion. peaks:
    largest acceleration and jerk of each axis, counts/s², counts/s³. rate: the feed override wanted; more than 1 is
    taken on where the axes allow it.
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
    triggers: Sequence[PathTrigger] = field(default=())

    def make_options(self, member: str, chunk: ChunkPlan) -> ChunkOptions:
        """The options of a chunk for one of `members`."""
        own = [axis for axis in self.peaks[0] if controller_of(axis) == member]
        accelerations, jerks = ({split_name(axis)[1]: peaks[axis] for axis in own} for peaks in self.peaks)
        return ChunkOptions(end_s=chunk.end_s, last=chunk.last, peak_accelerations=accelerations, peak_jerks=jerks)

    def find_outputs(self) -> Mapping[str, list[OutputTrigger]]:
        """By controller, what it is to switch in this chunk."""
        outputs: dict[str, list[OutputTrigger]] = {}
        for trigger in self.triggers:
            owner, name = split_name(trigger.resolved.output)
            outputs.setdefault(owner, []).append(
                OutputTrigger(
                    output=name,
                    axis=find_own_axis(trigger.resolved),
                    instants_ns=GivenTrigger(trigger).find_part(self.chunk)[1],
                    pulse_ns=trigger.resolved.pulse_ns,
                    least_ns=trigger.least_ns,
                )
            )
        return outputs

    def require_rates(self) -> None:
        """Raise `Refusal` where the path can be played at no other rate, because a member has all of it loaded."""
        if not self.covers_all:
            members = {controller_of(axis) for axis in self.plan.profiles}
            other_members = ", ".join(sorted(members - self.members))
            raise Refusal("override", f"{other_members} has the whole path loaded already", "wait for its end")

    @property
    def covers_all(self) -> bool:
        """Whether all members can be continued, and so braked along the path."""
        return all(controller_of(axis) in self.members for axis in self.plan.profiles)


def make_chunk_ability(info: ControllerInfo) -> ChunkAbility:
    """How a controller takes paths in chunks."""
    most_s = min(info.chunk_s, LONGEST_CHUNK_S) if max(info.orders) > 2 else 0.0
    ability = info.chunk_triggers
    return ChunkAbility(most_s, ability is not None, ability is not None and ability.shows)


def plan_first_chunk(planned: PlannedStep, infos: Mapping[str, ControllerInfo]) -> FirstChunk | None:
    """Plan the first chunk; None if no member can be continued, if an output cannot be switched in chunks, and for a
    line on a trapezoid. infos: by member, of the owners of outputs, too. Raises `Refusal`, `PlanError`."""
    course = None if planned.path is None else planned.path.course
    whole_plan = planned.plan
    members = frozenset(member for member, info in infos.items() if info.chunk_s > 0.0)
    abilities = _find_abilities(planned, infos, members)
    if course is None or abilities is None or not members & {controller_of(axis) for axis in whole_plan.profiles}:
        return None
    triggers = [
        PathTrigger.of(trigger, whole_plan, planned.begun_s, planned.elapsed_ns) for trigger in planned.triggers
    ]
    most_s, load_s = _find_times(infos, members, abilities, triggers)
    clock = course.begin_at(planned.begun_s, planned.rate)
    chunk = course.plan_chunk(clock, 0.0, most_s)
    profiles = {
        axis: chunk.profiles[axis] if controller_of(axis) in members else profile
        for axis, profile in whole_plan.profiles.items()
    }
    duration_s = chunk.stop_s if len(members) == len(infos) else whole_plan.duration_s
    return FirstChunk(
        course=course,
        clock=clock,
        chunk=chunk,
        plan=StepPlan(duration_s, profiles, whole_plan.unmoved),
        members=members,
        most_s=most_s,
        load_s=load_s,
        peaks=course.find_peaks(),
        rate=planned.rate,
        triggers=triggers,
    )


def _find_abilities(
    planned: PlannedStep, infos: Mapping[str, ControllerInfo], members: Collection[str]
) -> dict[str, ChunkTriggers] | None:
    """How the owners of outputs take triggers with chunks; None if one of them does not."""
    abilities: dict[str, ChunkTriggers] = {}
    for trigger in planned.triggers:
        ability = infos[trigger.owner].chunk_triggers
        if ability is None or trigger.owner not in members:
            return None
        abilities[trigger.owner] = ability
    return abilities


def _find_times(
    infos: Mapping[str, ControllerInfo],
    members: Collection[str],
    abilities: Mapping[str, ChunkTriggers],
    triggers: Sequence[PathTrigger],
) -> tuple[float, float]:
    """The longest chunk that all members take, and how long before its end the loading of the next one begins, s."""
    most_s = min([LONGEST_CHUNK_S, *(infos[member].chunk_s for member in members)])
    for owner, ability in abilities.items():
        count = _count_most(most_s, triggers, owner)
        most_s *= min(1.0, ability.most / max(1, count))
    load_s = LEAST_LOAD_S
    for member in members:
        ability = abilities.get(member)
        switching_ns = 0 if ability is None else _count_most(most_s, triggers, member) * ability.load_ns
        load_s = max(load_s, infos[member].chunk_load_s + switching_ns / NS_PER_S)
    return most_s, min(SPARE_LOAD_S + load_s, most_s)


def _count_most(within_s: float, triggers: Sequence[PathTrigger], owner: str) -> int:
    return sum(trigger.find_most(within_s) for trigger in triggers if trigger.resolved.owner == owner)
