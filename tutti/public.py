"""All public names of `tutti`, which has them from here when one is used."""

from orchestrator.client.api import Tutti
from orchestrator.client.armed import ArmedMove
from orchestrator.client.blocking import (
    BlockingArmedMove,
    BlockingJob,
    BlockingLiveJob,
    BlockingManualControl,
    BlockingTutti,
)
from orchestrator.client.jobs import SubmittedJob
from orchestrator.client.live import LiveJob, StepFailed
from orchestrator.client.manual import ManualControl
from orchestrator.client.ready import ReadyToBegin
from orchestrator.client.results import FleetStates, JobQueue, JobResult
from orchestrator.client.states import StateReading
from orchestrator.client.steps import JobFailed
from orchestrator.clock.owner import TaskOwner, running
from orchestrator.model.errors import ControllerFault, NotAllowed, Refusal, TuttiError
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, load_fleet
from orchestrator.model.jobs.forecast import JobForecast
from orchestrator.model.jobs.job import Job
from orchestrator.model.jobs.rest import JobRest
from orchestrator.model.jobs.restart import FirstMotion, StartPreview
from orchestrator.model.names import controller_of
from orchestrator.model.operation.alarms import AlarmRecord
from orchestrator.model.operation.axis_info import AxisInfo
from orchestrator.model.operation.statistics import StatisticsRead
from orchestrator.model.positions.entries import PositionEntry
from orchestrator.model.queue import QueueTerms
from orchestrator.model.report import (
    FINISHED_STATES,
    JobProgress,
    JobReport,
    JobTransition,
    PointRecord,
    QueueEntry,
    StepRecording,
    StepReport,
)
from orchestrator.model.script import WrongValue
from orchestrator.model.state import (
    AxisState,
    ClockQuality,
    ControllerEvent,
    ControllerInfo,
    ControllerState,
    ReadPosition,
    TimeInterval,
)
from orchestrator.model.steps.dwell import Dwell
from orchestrator.model.steps.home import Home
from orchestrator.model.steps.io import SetOutput, WaitInput
from orchestrator.model.steps.latch import Latch
from orchestrator.model.steps.live import Live
from orchestrator.model.steps.motors import Disable, Enable
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.probe import Probe
from orchestrator.model.steps.repeat import JobStep as Step
from orchestrator.model.steps.repeat import Repeat
from orchestrator.model.steps.save_position import SavePosition
from orchestrator.model.steps.scan import Scan
from orchestrator.model.steps.set_position import SetPosition
from orchestrator.model.steps.wait_armed import WaitArmed
from orchestrator.model.templates.arriving import read_job
from orchestrator.model.templates.template import Template, load_job

__all__ = [
    "FINISHED_STATES",
    "AlarmRecord",
    "ArmedMove",
    "AxisInfo",
    "AxisState",
    "BlockingArmedMove",
    "BlockingJob",
    "BlockingLiveJob",
    "BlockingManualControl",
    "BlockingTutti",
    "ClockQuality",
    "ControllerEvent",
    "ControllerFault",
    "ControllerInfo",
    "ControllerState",
    "Disable",
    "Dwell",
    "Enable",
    "FileError",
    "FirstMotion",
    "Fleet",
    "FleetStates",
    "FollowPath",
    "Home",
    "Job",
    "JobFailed",
    "JobForecast",
    "JobProgress",
    "JobQueue",
    "JobReport",
    "JobRest",
    "JobResult",
    "JobTransition",
    "Latch",
    "Live",
    "LiveJob",
    "ManualControl",
    "Move",
    "NotAllowed",
    "PointRecord",
    "PositionEntry",
    "Probe",
    "QueueEntry",
    "QueueTerms",
    "ReadPosition",
    "ReadyToBegin",
    "Refusal",
    "Repeat",
    "SavePosition",
    "Scan",
    "SetOutput",
    "SetPosition",
    "StartPreview",
    "StateReading",
    "StatisticsRead",
    "Step",
    "StepFailed",
    "StepRecording",
    "StepReport",
    "SubmittedJob",
    "TaskOwner",
    "Template",
    "TimeInterval",
    "Tutti",
    "TuttiError",
    "WaitArmed",
    "WaitInput",
    "WrongValue",
    "controller_of",
    "load_fleet",
    "load_job",
    "read_job",
    "running",
]
