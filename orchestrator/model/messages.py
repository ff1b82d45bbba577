"""Requests and replies on the bus. A refusal is a value: a reply says either what was done or why not."""

from typing import Literal

from pydantic import Field

from orchestrator.model.base import HostNs, Int53, Model
from orchestrator.model.profile import Profile
from orchestrator.model.state import ClockMapping, Costs, StartClass


class Refusal(Model):
    """Why something was not done, and what to do about it. `code` is for programs and does not change."""

    code: str
    text: str
    remedy: str = ""
    member: str | None = None


class Request(Model):
    """What every request carries."""

    request_id: str
    actor: str


class Reply(Model):
    """What every reply carries."""

    refused: Refusal | None = None


class Fenced(Request):
    """A request that only the reigning coordinator may make: epoch and uuid of its reign."""

    epoch: Int53
    coordinator: str


class Reign(Model):
    """The coordinator's heartbeat, and its fleet time: fleet_ns = host_ns - origin_host_ns on its own kernel."""

    schema_: Literal["tutti.reign/1"] = Field(default="tutti.reign/1", alias="schema")
    fleet: str
    epoch: Int53
    coordinator: str
    seq: Int53
    scale_id: str
    kernel_id: str
    origin_host_ns: HostNs
    utc: str


class TimeReply(Model):
    """The coordinator's fleet time when it answered."""

    scale_id: str
    fleet_ns: Int53


class Adopt(Fenced):
    """Take a controller into a reign: it obeys this epoch from now on, and no older one."""

    reign: Reign


class Adopted(Reply):
    epoch: Int53 = 0
    mode: str = "idle"


class StepRef(Fenced):
    """A request about one motion step."""

    job: str
    step: int


class Propose(StepRef):
    """Can you make these profiles? `digest` is the configuration that the coordinator believes in."""

    digest: str
    duration_s: float
    profiles: dict[str, Profile]
    start: Literal["auto", "clock", "host"] = "auto"


class Term(Model):
    """One term of a budget: the start lies between T0 + earliest_ns and T0 + latest_ns because of it."""

    name: Literal["clock", "wire", "firmware", "tick", "host", "quantisation"]
    earliest_ns: Int53
    latest_ns: Int53


class Proposal(Reply):
    """What a member can really make of the profiles."""

    durations_s: dict[str, float] = Field(default={}, description="By axis, as the controller will execute it.")
    path_error_counts: dict[str, float] = Field(default={}, description="Largest distance to the plan, by axis.")
    costs: Costs | None = None
    start_class: StartClass = "host"
    tick_ns: float = 0.0
    terms: list[Term] = Field(default=[])
    commands: list[str] = Field(default=[], description="What the controller would be sent, for people.")


class Arm(StepRef):
    """Load the move for a start at T0; do not move."""

    digest: str
    t0_fleet_ns: Int53
    profiles: dict[str, Profile]
    start: Literal["auto", "clock", "host"] = "auto"


class Armed(Reply):
    mapping: ClockMapping | None = None
    took_ns: Int53 = 0
    stages_ns: dict[str, Int53] = Field(default={}, description="Where the time of arming went.")


class Commit(StepRef):
    """Promise to start at T0 if `go` comes."""

    t0_fleet_ns: Int53


class Go(StepRef):
    """Every member has promised: begin at T0."""

    t0_fleet_ns: Int53


class Disarm(StepRef):
    """Unload; nothing starts."""


class Stop(Request):
    """Stop the controller, from anyone at any epoch. decelerate: by its planned ramp; abort: as fast as it can."""

    mode: Literal["decelerate", "abort"] = "decelerate"
    reason: str = ""


class AxesRequest(Fenced):
    """A request about axes of one controller, by their names in the fleet file."""

    axes: list[str]


class EnableRequest(AxesRequest):
    on: bool


class HomeRequest(AxesRequest):
    """Find the reference. The reply comes when it is found or has failed."""


class OutputRequest(Fenced):
    output: str
    value: bool


class Raw(Request):
    """A line in the make's own language. Logged; needs `i_know` because no limit is checked."""

    command: str
    i_know: bool = False


class RawReply(Reply):
    reply: str = ""


class Estop(Model):
    """Stops everything that hears it, and latches."""

    event: str
    actor: str
    reason: str = ""


class Reset(Request):
    """Release the e-stop latch named `event` (`None`: whichever is latched), and clear what can be cleared."""

    event: str | None = None


class TraceReply(Reply):
    """The last bytes on a controller's link, oldest first: (host ns, direction, bytes as latin-1 text)."""

    entries: list[tuple[HostNs, Literal["out", "in"], str]] = Field(default=[])
    utc: str = ""
    host_ns: HostNs = 0
