"""The verbs of `svc/{verb}` with the models of their requests and replies: one table for the coordinator, which serves
them, and for gateways, which pass them on."""

from typing import NamedTuple

from orchestrator.model.base import Model
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
    JobReference,
    JobReferences,
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
    RetryJob,
    StopFleet,
    SubmitJob,
    WiringChecked,
)
from orchestrator.model.messages import Reply, Request
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
from orchestrator.model.operation.statistics import ReadStatistics, StatisticsRead
from orchestrator.model.positions.entries import (
    PositionRemoved,
    PositionSaved,
    PositionsListed,
    RemovePosition,
    SavePosition,
)
from orchestrator.model.report import QueueState


class ServiceVerb(NamedTuple):
    """request, reply: its models. reads: it changes nothing, and may be executed twice."""

    request: type[Request]
    reply: type[Model]
    reads: bool = False


SERVICE_VERBS: dict[str, ServiceVerb] = {
    "submit": ServiceVerb(SubmitJob, JobSubmitted),
    "dry-run": ServiceVerb(DryRun, DryRunDone, reads=True),
    "list": ServiceVerb(ListJobs, QueueState, reads=True),
    "find": ServiceVerb(FindJob, JobsFound, reads=True),
    "show": ServiceVerb(JobReference, JobShown, reads=True),
    "points": ServiceVerb(ReadPoints, PointsRead, reads=True),
    "put-points": ServiceVerb(PutPoints, PointsPut, reads=True),
    "recording": ServiceVerb(RecordingReference, RecordingReply, reads=True),
    "cancel": ServiceVerb(JobReference, Reply),
    "retry": ServiceVerb(RetryJob, JobRetried),
    "hold": ServiceVerb(JobReferences, Reply),
    "release": ServiceVerb(JobReferences, Reply),
    "plan": ServiceVerb(JobReference, JobPlanned, reads=True),
    "approve": ServiceVerb(ApproveJob, Reply),
    "reorder": ServiceVerb(ReorderJob, Reply),
    "pause": ServiceVerb(PauseJob, Reply),
    "resume": ServiceVerb(JobReference, Reply),
    "override": ServiceVerb(OverrideJob, Reply),
    "prune": ServiceVerb(PruneJobs, JobsPruned),
    "stop": ServiceVerb(StopFleet, Reply),
    "start-queue": ServiceVerb(Request, Reply),
    "stop-queue": ServiceVerb(Request, Reply),
    "acquire-axes": ServiceVerb(AcquireAxes, AxesAcquired),
    "release-axes": ServiceVerb(ReleaseAxes, Reply),
    "reload": ServiceVerb(ReloadFleet, FleetReloaded),
    "check-wiring": ServiceVerb(Request, WiringChecked),
    "repair-epoch": ServiceVerb(Request, EpochRepaired),
    "positions": ServiceVerb(Request, PositionsListed, reads=True),
    "save-position": ServiceVerb(SavePosition, PositionSaved),
    "remove-position": ServiceVerb(RemovePosition, PositionRemoved),
    "alarms": ServiceVerb(ListAlarms, AlarmsListed, reads=True),
    "acknowledge": ServiceVerb(AcknowledgeAlarms, AlarmsAcknowledged),
    "shelve": ServiceVerb(ShelveAlarm, AlarmShelved),
    "statistics": ServiceVerb(ReadStatistics, StatisticsRead, reads=True),
    "commands": ServiceVerb(ListCommands, CommandsListed, reads=True),
    "names": ServiceVerb(Request, FleetNames, reads=True),
    "configuration": ServiceVerb(Request, FleetLoaded, reads=True),
}

VIEW_VERBS = (
    "alarms",
    "commands",
    "configuration",
    "find",
    "list",
    "names",
    "plan",
    "points",
    "positions",
    "recording",
    "show",
    "statistics",
)
"""The verbs of every role that may look: those that read, without those that store points or compute a forecast."""
