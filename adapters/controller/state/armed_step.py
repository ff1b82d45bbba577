"""The step that a controller has loaded, and how far it has come."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

from adapters.controller.state.axis_way import AxisWay
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.fleet import FleetScale
from orchestrator.model.messages import StepRequest
from orchestrator.model.profile import Profile
from orchestrator.model.state import Mode


class StepPhase(Enum):
    """Progress of an armed step. LOADING: the adapter loads it after the step before."""

    LOADING = "loading"
    ARMED = "armed"
    COMMITTED = "committed"
    RELEASED = "released"
    MOVING = "moving"


@dataclass(frozen=True, slots=True)
class ArmedStep:
    """The step that is loaded in the controller.

    promised_s: by axis, from T0 to its end, as far as it is released. ways: by axis, where it may be meanwhile; none
    after a stop.
    early_ns: how long before T0 an axis may begin."""

    job: str
    step: int
    t0_fleet_ns: int
    t0_host_ns: int
    axes: tuple[str, ...]
    scale: FleetScale
    can_advance: bool
    promised_s: dict[str, float] = field(default_factory=dict[str, float])
    clock_ppm: float = 0.0
    ways: dict[str, AxisWay] = field(default_factory=dict[str, AxisWay])
    early_ns: int = 0
    phase: StepPhase = StepPhase.ARMED

    @property
    def mode(self) -> Mode:
        """What the controller does with it, as its state says."""
        if self.executes:
            return "moving"
        return "committed" if self.phase is StepPhase.COMMITTED else "armed"

    @property
    def ends_host_ns(self) -> int:
        """When its last axis should have ended, as promised; host time."""
        return self.t0_host_ns + round(max(self.promised_s.values(), default=0.0) * NS_PER_S)

    @property
    def executes(self) -> bool:
        """Whether it is released, or moves."""
        return self.phase in (StepPhase.RELEASED, StepPhase.MOVING)

    def is_before_begin(self, at_ns: int) -> bool:
        """Whether no axis can have begun at this instant, host time."""
        return self.phase is not StepPhase.MOVING and at_ns < self.t0_host_ns - self.early_ns

    def widen_ways(self, profiles: Mapping[str, Profile], path_errors: Mapping[str, float]) -> None:
        """It may go on by these profiles, by axis. path_errors: by how many counts what is loaded is off them."""
        for axis, way in self.ways.items():
            self.ways[axis] = way.widen(profiles[axis], path_errors.get(axis, 0.0))

    def note_ends(self, profiles: Mapping[str, Profile]) -> None:
        """It ends where these profiles do, by axis; its ways are wide enough for them."""
        for axis, way in self.ways.items():
            self.ways[axis] = replace(way, end=profiles[axis].end_counts)

    def is_for(self, request: StepRequest, t0_fleet_ns: int | None = None) -> bool:
        """Whether it is the step that a request is about; for this T0, if one is given."""
        is_same_step = (self.job, self.step) == (request.job, request.step)
        return is_same_step and t0_fleet_ns in (None, self.t0_fleet_ns)

    def is_same(self, other: "ArmedStep | None") -> bool:
        """Whether it is the same step for the same T0, in any phase."""
        own_key = (self.job, self.step, self.t0_fleet_ns)
        return other is not None and own_key == (other.job, other.step, other.t0_fleet_ns)


@dataclass(frozen=True, slots=True)
class PastStep:
    """A step that was moved, from T0 to its end, host time."""

    job: str
    step: int
    t0_ns: int
    ended_ns: int
