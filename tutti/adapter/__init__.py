"""The contract for makes: what the package of a controller that Tutti does not know provides.

A make is two packages that never import each other: an adapter (this module, and `tutti.adapter.lines` for controllers
with simple text lines) and a simulator (`tutti.adapter.simulator`). `tutti adapter new` writes both, `tutti adapter
check` checks them. A `Make` and a `Simulator` state the version of the contract that they were written for as
`api_version`.
"""

from adapters.abilities import (
    LatchDriver,
    LearningDriver,
    LimitDriver,
    ManualDriver,
    OutputDriver,
    PathDriver,
    SamplingDriver,
    SettingsDriver,
    SharedLineDriver,
    ShownTriggerDriver,
    TriggerDriver,
)
from adapters.compat.version1 import PluginConnectedDriver as ConnectedDriver
from adapters.compat.version1 import PluginDriver as Driver
from adapters.compat.version1 import PluginMoverDriver as MoverDriver
from adapters.contract import (
    NULL_LOG,
    AxisReading,
    ChunkFit,
    ChunkInstants,
    ConfigError,
    ControllerIdentity,
    ControllerReading,
    ControllerRestarted,
    DriverCapabilities,
    DriverLog,
    DriverSetup,
    ExamplePlace,
    HostInterval,
    JogMove,
    LatchedPosition,
    LoadPlace,
    Lowered,
    Make,
    MoveOutcome,
    MoveSlot,
    MoveSlots,
    PathChunk,
    SampledPositions,
    SamplingPlan,
    SettingDifference,
    SlotMover,
    SlotState,
    SwitchedOutput,
    TimedWrite,
    TimedWriter,
    WriteResult,
    ends_too_early,
    require_no_problems,
    require_start_class,
    validate_options,
)
from adapters.toolkit.connection import MoverBehind, StepMover
from adapters.toolkit.firing import FiringOptions, learned_terms, missed_write_fault
from adapters.toolkit.frames import DecodedFrame, FrameDecoder, FrameDirection, TextDecoder
from adapters.toolkit.host_start import (
    MoverTools,
    moved_outcome,
    moving_intervals,
    require_time_left,
    resting_intervals,
    unmoved_outcome,
    wait_for_write,
)
from adapters.toolkit.path_error import path_error_counts
from adapters.toolkit.pending_reply import PendingReply
from adapters.toolkit.refusals import log_refusals
from adapters.toolkit.stop_counter import StopCounter, send_or_brake
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, Clock, sleep_ns, sleep_until_ns
from orchestrator.clock.estimator import TickMapping
from orchestrator.clock.inferred import InferredClock
from orchestrator.clock.latency import StartLatency
from orchestrator.clock.rate import CrystalRate
from orchestrator.link.base import Link, LinkClosed, LinkRefused, OpenLink, ReceivedBytes
from orchestrator.model.errors import ControllerFault, Refusal, TuttiError
from orchestrator.model.fleet import Axis, Controller, DigitalInput
from orchestrator.model.messages import BudgetTerm, StartOptions, TriggerDrive, TriggerWait
from orchestrator.model.plugins import API_VERSION
from orchestrator.model.profile import Profile, Segment
from orchestrator.model.state import FaultReport, StartClass, StepCosts

__all__ = [
    "API_VERSION",
    "NS_PER_MS",
    "NS_PER_S",
    "NS_PER_US",
    "NULL_LOG",
    "Axis",
    "AxisReading",
    "BudgetTerm",
    "ChunkFit",
    "ChunkInstants",
    "Clock",
    "ConfigError",
    "ConnectedDriver",
    "Controller",
    "ControllerFault",
    "ControllerIdentity",
    "ControllerReading",
    "ControllerRestarted",
    "CrystalRate",
    "DecodedFrame",
    "DigitalInput",
    "Driver",
    "DriverCapabilities",
    "DriverLog",
    "DriverSetup",
    "ExamplePlace",
    "FaultReport",
    "FiringOptions",
    "FrameDecoder",
    "FrameDirection",
    "HostInterval",
    "InferredClock",
    "JogMove",
    "LatchDriver",
    "LatchedPosition",
    "LearningDriver",
    "LimitDriver",
    "Link",
    "LinkClosed",
    "LinkRefused",
    "LoadPlace",
    "Lowered",
    "Make",
    "ManualDriver",
    "MoveOutcome",
    "MoveSlot",
    "MoveSlots",
    "MoverBehind",
    "MoverDriver",
    "MoverTools",
    "OpenLink",
    "OutputDriver",
    "PathChunk",
    "PathDriver",
    "PendingReply",
    "Profile",
    "ReceivedBytes",
    "Refusal",
    "SampledPositions",
    "SamplingDriver",
    "SamplingPlan",
    "Segment",
    "SettingDifference",
    "SettingsDriver",
    "SharedLineDriver",
    "ShownTriggerDriver",
    "SlotMover",
    "SlotState",
    "StartClass",
    "StartLatency",
    "StartOptions",
    "StepCosts",
    "StepMover",
    "StopCounter",
    "SwitchedOutput",
    "TextDecoder",
    "TickMapping",
    "TimedWrite",
    "TimedWriter",
    "TriggerDrive",
    "TriggerDriver",
    "TriggerWait",
    "TuttiError",
    "WriteResult",
    "ends_too_early",
    "learned_terms",
    "log_refusals",
    "missed_write_fault",
    "moved_outcome",
    "moving_intervals",
    "path_error_counts",
    "require_no_problems",
    "require_start_class",
    "require_time_left",
    "resting_intervals",
    "send_or_brake",
    "sleep_ns",
    "sleep_until_ns",
    "unmoved_outcome",
    "validate_options",
    "wait_for_write",
]
