"""Requests and replies on the bus. A refusal is a value: a reply says either what was done or why not."""

from typing import Any, Literal

from pydantic import Field

from orchestrator.model.base import HostNs, Id, Int53, Model
from orchestrator.model.profile import Profile
from orchestrator.model.state import ClockMapping, ControllerState, Costs, StartClass, StartWish
from orchestrator.model.units import Quantity


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


class Together(Model):
    """The same verb to several controllers of one adapter host.

    requests: by controller, the JSON text of its own request. within_ns: who has not answered by then is left out of
    the reply, and goes on.
    """

    requests: dict[Id, str] = Field(min_length=1)
    within_ns: Int53 = Field(gt=0)


class TogetherReply(Model):
    """By controller: the JSON text of its own reply, or why its request could not be understood; neither of who is not
    there or has not answered in time. took_ns: from the common request to each answer."""

    replies: dict[Id, str] = Field(default={})
    errors: dict[Id, str] = Field(default={})
    took_ns: dict[Id, Int53] = Field(default={})


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


class LineWait(Model):
    """Start when a wired line becomes active.

    input: the member's own, by name. The edge is at its terminal between T0 + earliest_ns and T0 + latest_ns.
    """

    input: Id
    earliest_ns: Int53
    latest_ns: Int53


class LineDrive(Model):
    """Make a wired line active at T0, and passive again once it has been so for `hold_ns`. output: own, by name."""

    output: Id
    hold_ns: Int53 = 100_000_000


class StartWay(Model):
    """How a member is to start.

    by: a start class, or whichever is best; with `wait` it is `line`. lead_ns: how far T0 is ahead of the last reading
    of the controller's clock, at the most: what is promised of clocks is promised for so long. drive: a member may
    drive a line and move axes as well, or only drive it (no profiles). exact: T0 is just so far ahead. brake_s: how
    long a stop from the peak velocity should take, so that all axes of the step stay on their common path and come to
    rest together; 0: as short as the limits allow. end_ns: how long after T0 a member that ends at ticks of its own
    should end: at most some ticks after the plan, where all members' ticks fall close together; 0: with the plan.
    early_ns: how much before the plan an axis may end that can not go so slowly.
    """

    by: StartWish = "auto"
    lead_ns: Int53 = 0
    exact: bool = False
    brake_s: float = 0.0
    end_ns: Int53 = 0
    early_ns: Int53 = 0
    wait: LineWait | None = None
    drive: LineDrive | None = None


class Propose(StepRef):
    """Can you make these profiles? `digest` is the configuration that the coordinator believes in."""

    digest: str
    duration_s: float
    profiles: dict[str, Profile]
    start: StartWay = StartWay()


class Term(Model):
    """One term of a budget: the start lies between T0 + earliest_ns and T0 + latest_ns because of it."""

    name: Literal["clock", "wire", "firmware", "tick", "host", "quantisation", "slip", "line", "input"]
    earliest_ns: Int53
    latest_ns: Int53


class Proposal(Reply):
    """What a member can really make of the profiles."""

    durations_s: dict[str, float] = Field(default={}, description="By axis, as the controller will execute it.")
    path_error_counts: dict[str, float] = Field(default={}, description="Largest distance to the plan, by axis.")
    costs: Costs | None = None
    start_class: StartClass = "host"
    tick_ns: float = 0.0
    tick_at_fleet_ns: Int53 | None = Field(default=None, description="One of the ticks that it could start at.")
    terms: list[Term] = Field(default=[])
    edge: list[Term] = Field(default=[], description="Where the edge of the line that it drives lies about T0.")
    clock_ppm: float = Field(default=100.0, description="How far off the unit's durations may be, guaranteed.")
    sooner: bool = Field(default=False, description="Whether it can be told to begin sooner than it was armed for.")
    commands: list[str] = Field(default=[], description="What the controller would be sent, for people.")


class Arm(StepRef):
    """Load the move for a start at T0; do not move."""

    digest: str
    t0_fleet_ns: Int53
    profiles: dict[str, Profile]
    start: StartWay = StartWay()


class Armed(Reply):
    """The step is loaded. durations_s, terms, edge: as in the proposal, with the clock mapping that is frozen into it,
    at T0."""

    durations_s: dict[str, float] = Field(default={})
    terms: list[Term] = Field(default=[])
    edge: list[Term] = Field(default=[])
    mapping: ClockMapping | None = None
    took_ns: Int53 = 0
    stages_ns: dict[str, Int53] = Field(default={}, description="Where the time of arming went.")


class Commit(StepRef):
    """Promise to start at T0 if `go` comes; who can begin `sooner` promises every T0 before it by whole ticks, too."""

    t0_fleet_ns: Int53


class Go(StepRef):
    """Every member has promised: begin at T0.

    sooner_ns: by how much that is before the T0 that it was armed for, a whole number of the member's ticks (`tick_ns`
    of its proposal, if it has any); only for who has said that it can (`sooner`). slack_ns: how much later than it has
    promised a member may begin all the same, because the job allows more than was promised; who could only be later
    still does not begin.
    """

    t0_fleet_ns: Int53
    sooner_ns: Int53 = 0
    slack_ns: Int53 = 0


class Disarm(StepRef):
    """Unload; nothing starts."""


class Disarmed(Reply):
    """begun: who was released already was told to stop so late that it may have begun before."""

    begun: bool = False


StopMode = Literal["decelerate", "abort", "hold"]


class Stop(Request):
    """Stop the controller, from anyone at any epoch. decelerate: by its planned ramp; abort: as fast as it can; hold:
    by its planned ramp, and the step is followed until it is at rest, so that there is evidence of when that was."""

    mode: StopMode = "decelerate"
    reason: str = ""


class AxesRequest(Fenced):
    """A request about axes of one controller, by their names in the fleet file."""

    axes: list[str]


class LeaseRequest(AxesRequest):
    """From now on only `holder` may move these axes, for `ttl_ms` or until it is said again; 0 takes it back.

    What the holder moves when its lease ends is stopped. A job's holder is its id. reason: why it is taken back.
    taking: grows with each time that axes are taken, so that no late renewal revives what was taken back before.
    """

    holder: str
    taking: Int53 = 0
    reason: str = ""
    ttl_ms: int = Field(ge=0, le=60_000)


class LeaseReply(Reply):
    """state: as it is when somebody else has the axes now, so that nobody needs to ask for it; none when nothing has
    changed."""

    state: ControllerState | None = None


class LeasedRequest(AxesRequest):
    """A request that only the holder of the axes' leases may make."""

    holder: str


class EnableRequest(LeasedRequest):
    on: bool


class HomeRequest(LeasedRequest):
    """Find the reference. The reply comes when all axes have found it or failed."""


class HomeReply(Reply):
    """Axes that know where they are now, and those that have not found their reference, with the reason."""

    homed: list[str] = Field(default=[])
    failed: dict[str, Refusal] = Field(default={})


class SetPositionRequest(LeasedRequest):
    """Call the place where the one axis of `axes` stands `position` (None: take the offset away). Nothing moves."""

    position: Quantity | None


class ConfigureRequest(Fenced):
    """Take another configuration (a controller of a fleet file, in its JSON form); the adapter starts anew with it.

    check: only say whether it could be done.
    """

    configuration: dict[str, Any]
    check: bool = False


class JogRequest(Request):
    """Move axes at a velocity (unit/s, user's direction) for `valid_ms`; 0 stops the axis. From the lease's holder.

    seq: grows with each request of a holder; an older one that comes late is refused. renew: go on with what moves,
    or is still told to; an axis that has been stopped meanwhile stays stopped.
    """

    holder: str
    seq: Int53
    velocities: dict[str, float] = Field(min_length=1)
    renew: bool = False
    valid_ms: int = Field(default=200, ge=20, le=200)


class OutputRequest(Fenced):
    output: str
    value: bool


class Raw(Request):
    """A line in the make's own language. Logged; needs the leases of all axes, and `i_know`: no limit is checked."""

    holder: str
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
    """Release the e-stop latch named `event` (`None`: whichever is latched), and clear what can be cleared.

    check: only say whether the conditions for it hold.
    """

    event: str | None = None
    check: bool = False


class TraceReply(Reply):
    """The last bytes on a controller's link, oldest first: (host ns, direction, bytes as latin-1 text)."""

    entries: list[tuple[HostNs, Literal["out", "in"], str]] = Field(default=[])
    utc: str = ""
    host_ns: HostNs = 0
