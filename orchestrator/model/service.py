"""What users ask of the reigning coordinator, on `svc/{verb}`, and its answers."""

from typing import Any, Literal

from pydantic import Field

from orchestrator.model.base import Model
from orchestrator.model.job import Job
from orchestrator.model.messages import Reply, Request
from orchestrator.model.queue import MOST_STEPS, Terms, Utc
from orchestrator.model.report import JobReport, JobState, QueueEntry, StepRecording, Transition

LONGEST_HAND_S = 24 * 3600.0  # `tutti axis take --for`; who renews says much less
HAND = r"^hand-[a-z0-9-]{1,60}$"


class Submit(Request):
    """Take a job. The same `client_key` again gives the same job back."""

    job: Job
    client_key: str = Field(min_length=1, max_length=200)
    terms: Terms = Terms()
    dry_run: bool = False


class Submitted(Reply):
    """entry: how the job stands in the queue, its time resolved to UTC."""

    job_id: str = ""
    entry: QueueEntry | None = None
    dry_run: dict[str, Any] | None = None


class Again(Request):
    """Do an ended job again, from one of its steps on: a new job, linked to the old one by its `origin`.

    dry_run: only say where its axes stand now. terms: None leaves the old one's repeats, and nothing else of its terms.
    """

    job_id: str
    from_step: int = Field(default=0, ge=0, le=MOST_STEPS)
    client_key: str = Field(min_length=1, max_length=200)
    terms: Terms | None = None
    dry_run: bool = False


class AxisNow(Model):
    """Where an axis stands now, in its unit, as jobs speak of it; None: nobody knows."""

    axis: str
    unit: str
    position: float | None
    enabled: bool = False
    referenced: bool = False


class AgainReply(Submitted):
    """axes: those that the remaining steps move. warnings: what a person should think of before they are run."""

    steps: list[str] = Field(default=[], description="The remaining steps, in words.")
    axes: list[AxisNow] = Field(default=[])
    warnings: list[str] = Field(default=[])


class JobRef(Request):
    job_id: str


class PauseJob(JobRef):
    """Hold a running job at the end of its step; with `now`, inside a motion step: its axes brake together."""

    now: bool = False


class JobRefs(Request):
    """Several jobs. For `release`: none stands for all that are held."""

    job_ids: list[str] = Field(default=[], max_length=10_000)


class MoveJob(JobRef):
    """Put a queued job before another one; it gets that one's priority."""

    before: str


class Prune(Request):
    """Forget ended jobs that were submitted more than `older_s` ago, but none of the newest `keep`."""

    older_s: float = Field(ge=0, le=100 * 366 * 86_400)
    keep: int = Field(ge=0, le=100_000_000)


class Pruned(Reply):
    jobs: int = 0


class JobShown(Reply):
    """Everything the journal has of a job; `report` once it has ended."""

    entry: QueueEntry | None = None
    job: Job | None = None
    report: JobReport | None = None
    transitions: list[Transition] = Field(default=[])


class RecordingRef(JobRef):
    """The recording of one motion step of a job."""

    step: int = Field(ge=0, le=MOST_STEPS)


class Recorded(Reply):
    """None: the step moved nothing, or its recording is not kept any more."""

    recording: StepRecording | None = None


class ListJobs(Request):
    """The newest jobs: in a state, with a text in their name, submitted at an instant or later."""

    limit: int = Field(default=50, ge=1, le=10_000)
    state: JobState | None = None
    name: str = Field(default="", max_length=120)
    since: Utc | None = None


class StopFleet(Request):
    """Stop the running jobs, all their axes, and hold what is queued until somebody releases it."""

    mode: Literal["decelerate", "abort"] = "decelerate"


class Take(Request):
    """Take axes in hand: nothing else moves them until `holder` gives them back or `ttl_s` has passed without another
    such request, and jobs that need them wait. Refused (code `leased`) while a job or somebody else has one of them,
    and (code `permit`) while a permit of theirs is missing; when one is lost later, or an adapter starts anew, the
    lease ends.

    axes: axes, groups or controllers. holder: an id of the taker's own, new for each taking, `hand-…`. reserve: for
    work at the machine. The axes then stay the taker's when a permit is missing or lost, or the coordinator starts
    anew; only the right to move them is gone, until they have been given back and taken again.
    """

    axes: list[str] = Field(min_length=1)
    holder: str = Field(pattern=HAND)
    what: str = Field(default="by hand", max_length=80, description="Shown to those who are refused.")
    ttl_s: float = Field(default=3.0, ge=0.5, le=LONGEST_HAND_S)
    reserve: bool = False


class Taken(Reply):
    """All axes that are held now: whole controllers where their axes can not be told apart. may_move: they can be
    jogged; not so what is only reserved."""

    axes: list[str] = Field(default=[])
    may_move: bool = True


class GiveBack(Request):
    """Give back everything that a hand, `holder`, has; what still moves of it is stopped."""

    holder: str = Field(pattern=HAND)


class Reload(Request):
    """Take over another fleet file, in its JSON form, with idle and unleased controllers only."""

    configuration: dict[str, Any]


class Reloaded(Reply):
    """Controllers that have taken another configuration."""

    changed: list[str] = Field(default=[])


class WireFound(Model):
    """What was found of the wire from an output to an input, both `controller.point`."""

    output: str
    input: str
    ok: bool
    text: str
    remedy: str = ""


class WiringChecked(Reply):
    wires: list[WireFound] = Field(default=[])
