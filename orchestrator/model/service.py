"""What users ask of the reigning coordinator, on `svc/{verb}`, and its answers."""

from typing import Any, Literal

from pydantic import Field

from orchestrator.model.base import Model
from orchestrator.model.job import Job
from orchestrator.model.messages import Reply, Request
from orchestrator.model.report import JobReport, QueueEntry, StepRecording, Transition


class Submit(Request):
    """Take a job. The same `client_key` again gives the same job back."""

    job: Job
    client_key: str
    dry_run: bool = False


class Submitted(Reply):
    job_id: str = ""
    dry_run: dict[str, Any] | None = None


class JobRef(Request):
    job_id: str


class JobShown(Reply):
    """Everything the journal has of a job; `report` once it has ended."""

    entry: QueueEntry | None = None
    job: Job | None = None
    report: JobReport | None = None
    transitions: list[Transition] = Field(default=[])


class RecordingRef(JobRef):
    """The recording of one motion step of a job."""

    step: int = Field(ge=0)


class Recorded(Reply):
    """None: the step moved nothing, or its recording is not kept any more."""

    recording: StepRecording | None = None


class ListJobs(Request):
    limit: int = Field(default=50, ge=1, le=10_000)


class StopFleet(Request):
    """Stop the running job, all its axes."""

    mode: Literal["decelerate", "abort"] = "decelerate"


class Take(Request):
    """Take axes in hand: nothing else moves them until `holder` gives them back or `ttl_s` has passed without another
    such request. Refused (code `leased`) while a job or somebody else has one of them, and (code `permit`) while a
    permit of theirs is missing; when one is lost later, or an adapter starts anew, the lease ends.

    axes: axes, groups or controllers. holder: an id of the taker's own, new for each taking, `hand-…`.
    """

    axes: list[str] = Field(min_length=1)
    holder: str = Field(pattern=r"^hand-[a-z0-9-]{1,60}$")
    what: str = Field(default="by hand", max_length=80, description="Shown to those who are refused.")
    ttl_s: float = Field(default=3.0, ge=0.5, le=60)


class Taken(Reply):
    """All axes that are held now: whole controllers where their axes can not be told apart."""

    axes: list[str] = Field(default=[])


class GiveBack(Request):
    """Give back everything that `holder` has; what still moves of it is stopped."""

    holder: str


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
