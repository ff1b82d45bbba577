"""The verbs of `svc/{verb}`, and those of controllers that users have: one table for the coordinator, which serves and
logs them, for gateways, which pass them on by roles, and for the rights of keys."""

from collections.abc import Callable
from typing import Any, Literal, NamedTuple

from orchestrator.model.base import Model
from orchestrator.model.jobs.live import AskLive, LiveAsked, LiveRead, ReadLive
from orchestrator.model.jobs.restart import PreviewStart, ReleaseJobs, StartPreview, StartQueue
from orchestrator.model.jobs.service import (
    AcquireAxes,
    AxesAcquired,
    DryRun,
    DryRunDone,
    EpochRepaired,
    FindJob,
    FleetLoaded,
    FleetNames,
    FleetReloaded,
    GoJob,
    HandedOver,
    JobGone,
    JobReference,
    JobReferences,
    JobRetargeted,
    JobRetried,
    JobsFound,
    JobShown,
    JobsPruned,
    JobSubmitted,
    ListJobs,
    OverrideJob,
    PauseJob,
    PointsPut,
    PointsRead,
    PruneJobs,
    PutPoints,
    ReadPoints,
    RecordingReference,
    RecordingReply,
    ReleaseAxes,
    ReloadFleet,
    ReorderJob,
    RetargetJob,
    RetryJob,
    StopFleet,
    SubmitJob,
    WiringChecked,
)
from orchestrator.model.messages import ForgetRequest, JogRequest, RawReply, RawRequest, Reply, Request
from orchestrator.model.operation.alarms import (
    AcknowledgeAlarms,
    AlarmsAcknowledged,
    AlarmShelved,
    AlarmsListed,
    ListAlarms,
    ShelveAlarm,
)
from orchestrator.model.operation.approval import ApproveJob, JobPlanned
from orchestrator.model.operation.commands import CommandsListed, ListCommands
from orchestrator.model.operation.learned import ForgetTimes
from orchestrator.model.operation.statistics import ReadStatistics, StatisticsRead
from orchestrator.model.operation.virtual_state import VirtualStates
from orchestrator.model.operation.zone_state import ZoneState
from orchestrator.model.positions.entries import (
    PositionRemoved,
    PositionSaved,
    PositionsListed,
    RemovePosition,
    SavePosition,
)
from orchestrator.model.report import QueueState
from orchestrator.model.steps.numbers import name_step

UserRole = Literal["viewer", "proposer", "operator", "maintainer"]
"""A role of people and programs; each may do what those before it may."""


class ServiceVerb(NamedTuple):
    """A verb of a service.

    request, reply: its models. least_role: the least role that may use it. reads: it changes nothing, and may be
    executed twice. logged: whether the log of commands has it; steps of a live job are in the record of the job.
    subject: what a request is about, in words for the log of commands; empty: the whole fleet.
    """

    request: type[Request]
    reply: type[Model]
    least_role: UserRole
    reads: bool = False
    logged: bool = True
    subject: Callable[[Any], str] = lambda _: ""


def _name_job(request: JobReference) -> str:
    return request.job_id


def _describe_submission(request: SubmitJob) -> str:
    return f"{request.job.name!r}" + ", proposed" * request.terms.proposed


def _describe_retry(request: RetryJob) -> str:
    return f"{request.job_id} from {name_step(request.from_step)}"


def _describe_approval(request: ApproveJob) -> str:
    return f"{request.job_id} {request.plan}"


def _name_jobs(request: JobReferences) -> str:
    return " ".join(request.job_ids) or "none"


def _name_released_jobs(request: JobReferences) -> str:
    return " ".join(request.job_ids) or "all held jobs"


def _describe_place(request: ReorderJob) -> str:
    return f"{request.job_id} before {request.before}"


def _describe_pause(request: PauseJob) -> str:
    return request.job_id + " now" * request.now


def _describe_go(request: GoJob) -> str:
    return request.job_id + ("" if request.at_fleet_ns is None else f" at {request.at_fleet_ns} ns")


def _describe_override(request: OverrideJob) -> str:
    return f"{request.job_id} {request.percent:g} %"


def _describe_retarget(request: RetargetJob) -> str:
    targets = [*(f"{axis} to {target}" for axis, target in request.to.items())]
    targets += [f"{axis} by {distance}" for axis, distance in request.by.items()]
    return f"{request.job_id} {', '.join(targets)}"


def _describe_age(request: PruneJobs) -> str:
    return f"older than {request.older_s:g} s, but the newest {request.keep}"


def _describe_stop(request: StopFleet) -> str:
    return request.mode


def _describe_axes(request: AcquireAxes) -> str:
    return f"{' '.join(request.axes)}: {request.what}"


def _name_controllers(request: ForgetTimes) -> str:
    return " ".join(request.controllers) or "all controllers"


def _name_position(request: SavePosition | RemovePosition) -> str:
    return request.name


def _name_alarms(request: AcknowledgeAlarms) -> str:
    return " ".join(request.alarm_ids) or "all alarms"


def _describe_shelving(request: ShelveAlarm) -> str:
    return f"{request.alarm_id} " + ("no longer" if request.for_s is None else f"for {request.for_s:g} s")


NOT_LEADER = "this coordinator is no longer the leader; send the request again"
"""The error of a coordinator that has been overtaken: a client sends its request to the leader."""

SERVICE_VERBS: dict[str, ServiceVerb] = {
    "submit": ServiceVerb(SubmitJob, JobSubmitted, "proposer", subject=_describe_submission),
    "dry-run": ServiceVerb(DryRun, DryRunDone, "proposer", reads=True),
    "list": ServiceVerb(ListJobs, QueueState, "viewer", reads=True),
    "find": ServiceVerb(FindJob, JobsFound, "viewer", reads=True),
    "show": ServiceVerb(JobReference, JobShown, "viewer", reads=True),
    "points": ServiceVerb(ReadPoints, PointsRead, "viewer", reads=True),
    "put-points": ServiceVerb(PutPoints, PointsPut, "proposer", reads=True),
    "recording": ServiceVerb(RecordingReference, RecordingReply, "viewer", reads=True),
    "cancel": ServiceVerb(JobReference, Reply, "operator", subject=_name_job),
    "retry": ServiceVerb(RetryJob, JobRetried, "operator", subject=_describe_retry),
    "hold": ServiceVerb(JobReferences, Reply, "operator", subject=_name_jobs),
    "preview-start": ServiceVerb(PreviewStart, StartPreview, "viewer", reads=True),
    "release": ServiceVerb(ReleaseJobs, Reply, "operator", subject=_name_released_jobs),
    "plan": ServiceVerb(JobReference, JobPlanned, "viewer", reads=True),
    "approve": ServiceVerb(ApproveJob, Reply, "operator", subject=_describe_approval),
    "reorder": ServiceVerb(ReorderJob, Reply, "operator", subject=_describe_place),
    "pause": ServiceVerb(PauseJob, Reply, "operator", subject=_describe_pause),
    "resume": ServiceVerb(JobReference, Reply, "operator", subject=_name_job),
    "go": ServiceVerb(GoJob, JobGone, "operator", subject=_describe_go),
    "override": ServiceVerb(OverrideJob, Reply, "operator", subject=_describe_override),
    "ask-live": ServiceVerb(AskLive, LiveAsked, "operator", logged=False),
    "read-live": ServiceVerb(ReadLive, LiveRead, "viewer", reads=True),
    "stop-live": ServiceVerb(JobReference, Reply, "operator", subject=_name_job),
    "end-live": ServiceVerb(JobReference, Reply, "operator", subject=_name_job),
    "retarget": ServiceVerb(RetargetJob, JobRetargeted, "operator", subject=_describe_retarget),
    "prune": ServiceVerb(PruneJobs, JobsPruned, "maintainer", subject=_describe_age),
    "stop": ServiceVerb(StopFleet, Reply, "viewer", subject=_describe_stop),
    "start-queue": ServiceVerb(StartQueue, Reply, "operator"),
    "stop-queue": ServiceVerb(Request, Reply, "operator"),
    "acquire-axes": ServiceVerb(AcquireAxes, AxesAcquired, "operator", subject=_describe_axes),
    "release-axes": ServiceVerb(ReleaseAxes, Reply, "operator"),
    "reload": ServiceVerb(ReloadFleet, FleetReloaded, "maintainer"),
    "check-wiring": ServiceVerb(Request, WiringChecked, "operator"),
    "hand-over": ServiceVerb(Request, HandedOver, "maintainer"),
    "repair-epoch": ServiceVerb(Request, EpochRepaired, "maintainer"),
    "forget-times": ServiceVerb(ForgetTimes, Reply, "maintainer", subject=_name_controllers),
    "positions": ServiceVerb(Request, PositionsListed, "viewer", reads=True),
    "save-position": ServiceVerb(SavePosition, PositionSaved, "operator", subject=_name_position),
    "remove-position": ServiceVerb(RemovePosition, PositionRemoved, "maintainer", subject=_name_position),
    "alarms": ServiceVerb(ListAlarms, AlarmsListed, "viewer", reads=True),
    "acknowledge": ServiceVerb(AcknowledgeAlarms, AlarmsAcknowledged, "operator", subject=_name_alarms),
    "shelve": ServiceVerb(ShelveAlarm, AlarmShelved, "operator", subject=_describe_shelving),
    "statistics": ServiceVerb(ReadStatistics, StatisticsRead, "viewer", reads=True),
    "commands": ServiceVerb(ListCommands, CommandsListed, "viewer", reads=True),
    "names": ServiceVerb(Request, FleetNames, "viewer", reads=True),
    "virtual": ServiceVerb(Request, VirtualStates, "viewer", reads=True),
    "zones": ServiceVerb(Request, ZoneState, "viewer", reads=True),
    "configuration": ServiceVerb(Request, FleetLoaded, "viewer", reads=True),
}
"""The verbs of the coordinator, `svc/{verb}`."""

# Jogs are too many for the log; that their axes were acquired is in it.
CONTROLLER_VERBS: dict[str, ServiceVerb] = {
    "forget": ServiceVerb(ForgetRequest, Reply, "maintainer"),
    "jog": ServiceVerb(JogRequest, Reply, "operator", reads=True),
    "raw": ServiceVerb(RawRequest, RawReply, "maintainer"),
}
"""The verbs of a controller that users have."""

VIEW_VERBS = tuple(sorted(name for name, verb in SERVICE_VERBS.items() if verb.reads and verb.least_role == "viewer"))
"""The verbs of every role that may look: those that read, without those that store points or compute a forecast."""
