"""Requests of users to the leader, on `svc/{verb}`, and its replies."""

from typing import Annotated, Any, Literal

from pydantic import Field

from orchestrator.model.base import Int53, Model
from orchestrator.model.jobs.forecast import AxisForecast, JobForecast
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import Reply, Request
from orchestrator.model.names import controller_of
from orchestrator.model.queue import MAX_FLAT_STEPS, MAX_STEPS, QueueTerms, Utc
from orchestrator.model.report import (
    JobProgress,
    JobReport,
    JobState,
    JobTransition,
    PointRecord,
    QueueEntry,
    StepRecording,
    StepReport,
)
from orchestrator.model.state import RetargetWay
from orchestrator.model.steps.points import DIGEST_PATTERN, MAX_POINTS, MAX_SCAN_AXES, PART_BYTES, PointAxis, PointTable
from orchestrator.model.text.text_fields import PLAIN_TEXT, SHOW_TEXT
from orchestrator.model.units import AxisQuantity, Unit

MAX_MANUAL_LEASE_S = 24 * 3600.0  # `tutti axis acquire --for`; a client that renews uses a much shorter one
MAX_RETARGET_AXES = 256
MANUAL_HOLDER_PATTERN = r"^manual-[a-z0-9-]{1,60}$"


class SubmitJob(Request):
    """Submit a job. The same `client_key` again returns the same job."""

    job: Job
    client_key: Annotated[str, PLAIN_TEXT] = Field(min_length=1, max_length=200)
    terms: QueueTerms = QueueTerms()


class JobSubmitted(Reply):
    """entry: the job's place in the queue, with its time resolved to UTC."""

    job_id: str = ""
    entry: QueueEntry | None = None


class DryRun(Request):
    """Run steps of a job forward and ask the controllers what they would be sent; nothing moves.

    A client sends the steps of a long job in parts. first: the number of the first step in the job. begin: the axes
    after the part before; None: from where they are now.
    """

    job: Job
    first: int = Field(default=0, ge=0, le=MAX_STEPS)
    begin: dict[str, AxisForecast] | None = None


class DryRunDone(Reply):
    """end: the axes after these steps, where the next part begins."""

    forecast: JobForecast = JobForecast()
    end: dict[str, AxisForecast] = Field(default={})


class RetryJob(Request):
    """Re-run a finished job, from one of its steps on: a new job, linked to the old one by its `origin`.

    from_step: counted from 0. from_point: of the scan that step `from_step` belongs to, from 1.
    dry_run: only report the current positions of its axes. terms: None keeps the old job's repeats, and no other terms.
    """

    job_id: str
    from_step: int = Field(default=0, ge=0, le=MAX_FLAT_STEPS)
    from_point: int | None = Field(default=None, ge=1, le=MAX_POINTS)
    client_key: Annotated[str, PLAIN_TEXT] = Field(min_length=1, max_length=200)
    terms: QueueTerms | None = None
    dry_run: bool = False


class AxisPosition(Model):
    """The current position of an axis, in its unit, in user coordinates; None if it is not known."""

    axis: str
    unit: str
    position: float | None
    enabled: bool = False
    referenced: bool = False


class JobRetried(JobSubmitted):
    """axes: those that the remaining steps move. warnings: what to consider before they are run."""

    steps: list[str] = Field(default=[], description="The remaining steps, in words, numbered from 1.")
    axes: list[AxisPosition] = Field(default=[])
    warnings: list[str] = Field(default=[])


class FleetNames(Reply):
    """The names of a fleet, in the order of its file. axes, virtual: their units; groups, positions: their axes;
    virtual_groups: the real axes of their virtual ones. Inputs and outputs are `controller.name`."""

    controllers: list[str] = Field(default=[])
    axes: dict[str, Unit] = Field(default={})
    groups: dict[str, list[str]] = Field(default={})
    positions: dict[str, list[str]] = Field(default={})
    virtual: dict[str, Unit] = Field(default={})
    virtual_groups: dict[str, list[str]] = Field(default={})
    inputs: list[str] = Field(default=[])
    outputs: list[str] = Field(default=[])

    def expand_name(self, name: str) -> list[str]:
        """The axes that a group, a controller or an axis stands for, and the real ones of virtual axes; none for an
        unknown name."""
        if name in self.groups:
            return self.groups[name]
        if name in self.virtual_groups or name in self.virtual:
            return self.virtual_groups[controller_of(name)]
        return [axis for axis in self.axes if name in (axis, controller_of(axis))]


class FindJob(Request):
    """Find a job. reference: the beginning of its id, its whole name, or `last`: the newest job."""

    reference: str = Field(min_length=1, max_length=120)


class JobsFound(Reply):
    """The jobs that fit, newest first, at most a few: of several the client has to choose."""

    jobs: list[QueueEntry] = Field(default=[])


class JobReference(Request):
    job_id: str


class PauseJob(JobReference):
    """Pause a running job after its current step; with `now`, inside a motion step by a feed hold of all its axes."""

    now: bool = False


class OverrideJob(JobReference):
    """Play the present path of a running job at another speed."""

    percent: float = Field(description="Of its planned speed, 10 to 120.")


class RetargetJob(JobReference):
    """Send the axes of the move that a job executes now to other targets, all of them. to: user positions; by:
    distances from the targets that they have."""

    to: dict[str, AxisQuantity] = Field(default={}, max_length=MAX_RETARGET_AXES)
    by: dict[str, AxisQuantity] = Field(default={}, max_length=MAX_RETARGET_AXES)


class JobRetargeted(Reply):
    """step: the number of the move. outcome: `changed`; `same`: the axes had these targets already; `replaced`: a newer
    request has taken its place. way, within_s: how the targets change, and the most time from the request until
    set-points do."""

    step: Int53 | None = None
    outcome: Literal["changed", "same", "replaced"] = "changed"
    way: RetargetWay = "brake"
    within_s: float = 0.0


class GoJob(JobReference):
    """Start the step of a running job that waits armed. at_fleet_ns: its T0; None: as soon as all controllers can."""

    at_fleet_ns: Int53 | None = None


class JobGone(Reply):
    """t0_fleet_ns: the instant at which all axes start, which is agreed; where one was asked for, that one, which is
    agreed shortly before it."""

    t0_fleet_ns: Int53 | None = None


class JobReferences(Request):
    """Several jobs. For `release`: an empty list stands for all held jobs."""

    job_ids: list[str] = Field(default=[], max_length=10_000)


class ReorderJob(JobReference):
    """Move a queued job before another one; it gets that one's priority."""

    before: str


class PruneJobs(Request):
    """Delete finished jobs that were submitted more than `older_s` ago, except the newest `keep`."""

    older_s: float = Field(ge=0, le=100 * 366 * 86_400)
    keep: int = Field(ge=0, le=100_000_000)


class JobsPruned(Reply):
    jobs: int = 0


class JobShown(Reply):
    """All that the journal has of a job; `report` once it has ended. While it runs: `progress`, and the report of its
    last motion step, if one has ended."""

    entry: QueueEntry | None = None
    job: Job | None = None
    report: JobReport | None = None
    transitions: list[JobTransition] = Field(default=[])
    progress: JobProgress | None = None
    last_motion: StepReport | None = None


class RecordingReference(JobReference):
    """The recording of one motion step of a job."""

    step: int = Field(ge=0, le=MAX_FLAT_STEPS)


class RecordingReply(Reply):
    """None: the step moved nothing, or its recording has been deleted."""

    recording: StepRecording | None = None


class ReadPoints(JobReference):
    """Recorded points of the scans of a job, in their order: those after point `after_point` of the scan that begins
    with step `after_step`."""

    after_step: int = Field(default=-1, ge=-1, le=MAX_FLAT_STEPS)
    after_point: int = Field(default=0, ge=0, le=MAX_POINTS)
    limit: int = Field(default=1000, ge=1, le=5000)


class PointsRead(Reply):
    """Fewer points than the limit are the last ones so far."""

    points: list[PointRecord] = Field(default=[])


class PutPoints(Request):
    """Store points of a scan, before the job that names them. First without `data`, then part by part, in order.

    digest: SHA-256 of the header (`scan.make_header`) and all rows. count: of all points. begin: how many bytes
    come before `data`, which is base64 of whole rows: doubles, little-endian, one for each of `axes`.
    """

    digest: str = Field(pattern=DIGEST_PATTERN)
    axes: list[PointAxis] = Field(min_length=1, max_length=MAX_SCAN_AXES)
    count: int = Field(ge=1, le=MAX_POINTS)
    begin: int = Field(default=0, ge=0)
    data: str = Field(default="", max_length=2 * PART_BYTES)


class PointsPut(Reply):
    """received: bytes that are stored; the next part begins there. points: once all are, and the digest is right."""

    received: int = 0
    points: PointTable | None = None


class ListJobs(Request):
    """List the newest jobs: in a state, with a text in their name, submitted at an instant or later.

    before: the id of a job; only those that were submitted before it, for the next part of a long list.
    """

    limit: int = Field(default=50, ge=1, le=10_000)
    state: JobState | None = None
    name: str = Field(default="", max_length=120)
    since: Utc | None = None
    before: Annotated[str, PLAIN_TEXT] = Field(default="", max_length=64)


class StopFleet(Request):
    """Stop the running jobs and all axes, and hold all queued jobs until they are released."""

    mode: Literal["decelerate", "abort"] = "decelerate"


class AcquireAxes(Request):
    """Acquire axes for manual control: nothing else moves them until `holder` releases them or `ttl_s` has passed
    without a renewal, and jobs that need them wait. Refused with code `leased` while a job or another holder has one
    of them, and with code `permit` while a permit of theirs is missing. The lease ends when a permit is lost later,
    or when an adapter restarts.

    axes: axes, groups or controllers. holder: an id of the client's own, new for each acquisition, `manual-…`. reserve:
    for work at the machine. The axes then stay reserved when a permit is missing or lost, and when the coordinator
    restarts; only the right to move them ends, until they have been released and acquired again.
    """

    axes: list[str] = Field(min_length=1)
    holder: str = Field(pattern=MANUAL_HOLDER_PATTERN)
    what: Annotated[str, SHOW_TEXT] = Field(
        default="manual control", max_length=80, description="Shown to clients that are refused."
    )
    ttl_s: float = Field(default=3.0, ge=0.5, le=MAX_MANUAL_LEASE_S)
    reserve: bool = False


class AxesAcquired(Reply):
    """All axes that are acquired: whole controllers where their axes cannot be leased separately. may_move: they can be
    jogged; false for axes that are only reserved."""

    axes: list[str] = Field(default=[])
    may_move: bool = True


class ReleaseAxes(Request):
    """Release all axes of a manual `holder`; those that still move are stopped."""

    holder: str = Field(pattern=MANUAL_HOLDER_PATTERN)


class ReloadFleet(Request):
    """Load another fleet file, in its JSON form; only idle controllers without a lease may change."""

    configuration: dict[str, Any]


class FleetReloaded(Reply):
    """The controllers whose configuration has changed."""

    changed: list[str] = Field(default=[])


class FleetLoaded(Reply):
    """The fleet file as it runs, in its JSON form, without the commands that are run for alarms. digest: `Fleet.digest`
    of the file that runs."""

    configuration: dict[str, Any] = Field(default={})
    digest: str = ""


class HandedOver(Reply):
    """The standbys that wait, one of which leads next: their names on the bus."""

    standbys: list[str] = Field(default=[])


class EpochRepaired(Reply):
    """The controllers that have accepted the epoch of this leader; empty if all had adopted it already."""

    controllers: list[str] = Field(default=[])


class WireFinding(Model):
    """The result for the wire from an output to an input, both `controller.point`."""

    output: str
    input: str
    ok: bool
    text: str
    remedy: str = ""


class WiringChecked(Reply):
    wires: list[WireFinding] = Field(default=[])
