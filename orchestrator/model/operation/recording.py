"""What only a recording of a run contains: the job as it began, positions at step starts, and what was left out."""

from typing import Literal

from pydantic import Field

from orchestrator.model.base import HostNs, Int53, Model
from orchestrator.model.jobs.job import Job
from orchestrator.model.report import PointRecord, TriggerRow
from orchestrator.model.state import TimeInterval


class JobBegun(Model):
    """A job as it began, on `job/{id}/begun`.

    repeat, from_step: as in its report. positions_used: the values of the named positions of its targets, by name and
    axis.
    """

    schema_: Literal["tutti.begun/1"] = Field(default="tutti.begun/1", alias="schema")
    job_id: str
    name: str
    actor: str
    utc: str
    epoch: Int53
    repeat: int
    from_step: int
    positions_used: dict[str, dict[str, str]] = Field(default={})
    job: Job


class AxisReading(Model):
    """The last reading of an axis before an instant. position: user position, in `unit`.

    read_fleet_ns: when its poll's answer had arrived; None: the adapter had no fleet time.
    """

    position: float
    commanded: float
    raw_counts: float
    unit: str
    moving: bool
    referenced: bool
    read_fleet_ns: Int53 | None


class StepStart(Model):
    """Where all axes of the fleet were when a step of a job began, also those that the step does not move.

    start: of the first axis that moves, by its controller's evidence; None: nothing moved.
    """

    schema_: Literal["tutti.step-start/1"] = Field(default="tutti.step-start/1", alias="schema")
    job_id: str
    step: Int53
    start: TimeInterval | None
    axes: dict[str, AxisReading]


class SampledAxis(Model):
    """counts: positions as the controller has sampled them; position in `unit`: counts / counts_per_unit (motor
    position)."""

    unit: str
    counts_per_unit: float
    counts: list[Int53]


class StepSamples(Model):
    """Positions that a controller has sampled by itself during a step, on `job/{id}/samples`.

    fleet_ns: the instants of the samples, each within ± bound_ns, which is guaranteed by the controller's clock mapping
    and the resolution of its counter, or by the times of its bus.
    """

    schema_: Literal["tutti.samples/1"] = Field(default="tutti.samples/1", alias="schema")
    job_id: str
    step: Int53
    controller: str
    fleet_ns: list[Int53]
    bound_ns: Int53
    axes: dict[str, SampledAxis]


class RecordedTriggers(Model):
    """All instants of one trigger of a step, on `job/{id}/triggers`, in parts of at most some hundred rows."""

    schema_: Literal["tutti.triggers/1"] = Field(default="tutti.triggers/1", alias="schema")
    job_id: str
    step: Int53
    output: str
    rows: list[TriggerRow]


class JobPoints(Model):
    """Rows of the points of a job's scans, on `job/{id}/points`: each once, in order, as soon as it is final.

    after_step, after_point: the row before the first one of these, as in `svc/points`; -1 and 0: there is none. A
    reader whose last row is another one has missed rows, and asks for them.
    """

    schema_: Literal["tutti.points/1"] = Field(default="tutti.points/1", alias="schema")
    job_id: str
    after_step: Int53
    after_point: Int53
    rows: list[PointRecord]


class MessagesDropped(Model):
    """Messages that the recorder has left out, and why. by_key: their number by key."""

    schema_: Literal["tutti.dropped/1"] = Field(default="tutti.dropped/1", alias="schema")
    reason: str
    total: Int53
    by_key: dict[str, Int53]


class WallClockStepped(Model):
    """The wall clock of the recorder's host was set. Times in an open file stay on the scale with which it began.

    by_ns: how much later it shows now.
    """

    schema_: Literal["tutti.clock-stepped/1"] = Field(default="tutti.clock-stepped/1", alias="schema")
    by_ns: HostNs
