"""The channels of a recording: which keys are recorded, and the model and JSON schema of each."""

import json
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache, lru_cache
from types import MappingProxyType

from pydantic import ValidationError

from orchestrator.bus.keys import ROOT
from orchestrator.model.base import Model
from orchestrator.model.jobs.live import LiveResult
from orchestrator.model.messages import EstopMessage, EstopReset, LeaderHeartbeat
from orchestrator.model.operation.alarms import AlarmRecord, AlarmRequest
from orchestrator.model.operation.recording import (
    JobBegun,
    JobPoints,
    MessagesDropped,
    RecordedTriggers,
    StepSamples,
    StepStart,
    WallClockStepped,
)
from orchestrator.model.operation.virtual_state import VirtualState
from orchestrator.model.problems import describe_first_error
from orchestrator.model.report import JobProgress, JobReport, LeaseState, QueueState, StepRecording
from orchestrator.model.state import ClockMapping, ControllerEvent, ControllerState, LinkTotals

JSON = "json"
BYTES = ""  # of payloads that are not valid for their key
MAX_KEYS_KEPT = 10_000  # of channels that are looked up: each job has some
INVALID = "#invalid"  # ends the topic of their channel

# What a key without ids is, below the fleet's prefix: its first chunk and its last one.
_MODELS: Mapping[tuple[str, str], type[Model]] = MappingProxyType(
    {
        ("ctl", "state"): ControllerState,
        ("ctl", "event"): ControllerEvent,
        ("ctl", "clock"): ClockMapping,
        ("ctl", "link"): LinkTotals,
        ("job", "state"): JobProgress,
        ("job", "report"): JobReport,
        ("job", "begun"): JobBegun,
        ("job", "plan"): StepRecording,
        ("job", "samples"): StepSamples,
        ("job", "triggers"): RecordedTriggers,
        ("job", "points"): JobPoints,
        ("job", "live"): LiveResult,
        ("queue", "queue"): QueueState,
        ("virtual", "state"): VirtualState,
        ("leader", "leader"): LeaderHeartbeat,
        ("estop", "estop"): EstopMessage,
        ("estop-reset", "estop-reset"): EstopReset,
        ("recorder", "step-start"): StepStart,
        ("recorder", "dropped"): MessagesDropped,
        ("recorder", "clock-stepped"): WallClockStepped,
    }
)
# Of keys that end with an id, the first chunk alone.
_BY_FIRST: Mapping[str, type[Model]] = MappingProxyType(
    {"lease": LeaseState, "alarm": AlarmRecord, "alarm-request": AlarmRequest}
)
RECORDED_PARTS = (
    "job",
    "queue",
    "virtual",
    "leader",
    "estop",
    "estop-reset",
    "lease",
    "alarm",
    "alarm-request",
    "log",
    "user",
)
"""First chunks of what is recorded beside the controllers, whose hosts publish them in frames. `user`: of programs of
users, whatever it is."""

# Signs of life: they repeat several times a second that nothing has changed.
_NOT_RECORDED = frozenset({"session", "live"})
# May be left out first when the disk is too slow: the next one replaces it.
_REPLACED = frozenset(
    {
        ("ctl", "state"),
        ("virtual", "state"),
        ("ctl", "clock"),
        ("ctl", "link"),
        ("job", "state"),
        ("queue", "queue"),
        ("leader", "leader"),
    }
)


@dataclass(frozen=True, slots=True)
class Channel:
    """A key of a fleet. model: None: JSON without a schema of ours. is_replaced: the next message replaces this one."""

    key: str
    model: type[Model] | None
    is_recorded: bool
    is_replaced: bool

    @property
    def parts(self) -> list[str]:
        """The chunks of the key below the fleet's prefix."""
        return self.key.split("/")[3:]


@lru_cache(maxsize=MAX_KEYS_KEPT)
def find_channel(key: str) -> Channel:
    """Return the channel of a key."""
    parts = key.split("/")[3:]
    kind = (parts[0], parts[-1]) if parts else ("", "")
    model = _BY_FIRST.get(kind[0]) or _MODELS.get(kind)
    return Channel(key, model, kind[0] not in _NOT_RECORDED, kind in _REPLACED)


def own_key(fleet: str, leaf: str) -> str:
    """The topic of what the recorder itself adds to a recording; not a key of the bus."""
    return f"{ROOT}/{fleet}/recorder/{leaf}"


@cache
def make_schema(model: type[Model]) -> tuple[str, bytes]:
    """Name and JSON schema of a model's messages."""
    schema = model.model_json_schema(by_alias=True, mode="serialization")
    name = schema.get("properties", {}).get("schema", {}).get("const", f"tutti.{model.__name__}")
    return name, json.dumps(schema, separators=(",", ":")).encode()


def parse_message(channel: Channel, payload: bytes) -> Model | None:
    """Return the message; None for JSON without a model. Raises `ValueError` for a payload that is not valid."""
    if channel.model is None:
        json.loads(payload)
        return None
    try:
        return channel.model.read_message(payload)
    except ValidationError as error:
        raise ValueError(describe_first_error(error, "")) from None
