"""The rest of a job that has ended on its way: where it stood, the way back to that place, and what is left."""

from pydantic import Field

from orchestrator.model.base import Model
from orchestrator.model.jobs.job import Job
from orchestrator.model.units import Unit


class AxisWay(Model):
    """The way of an axis back: from where it is, to where it stood, user positions in its unit."""

    axis: str
    unit: Unit
    here: float
    to: float


class JobRest(Model):
    """What is left of a job, and what a person has to see to before.

    continues: the id of that job. place: where it stood, in words; step: its number from 0; piece, line: of its path,
    from 1; point: of its scan, from 1. is_recorded: the place is by the recording of its last motion; otherwise by what
    is known without one. way: of axes that are elsewhere now. outputs: those that are switched before it goes on.
    confirm: what the machine does not do itself. steps: what is left, in words.

    move: the job that takes the axes back. job: the rest as a job; None: that of a scan, which runs again from step
    `retry_step` and point `point`. switch: the job that switches the outputs before the rest of a scan.
    """

    continues: str
    name: str
    place: str
    step: int
    piece: int | None = None
    line: int | None = None
    point: int | None = None
    is_recorded: bool = True
    way: list[AxisWay] = Field(default=[])
    outputs: dict[str, bool] = Field(default={})
    confirm: list[str] = Field(default=[])
    steps: list[str] = Field(default=[])
    move: Job | None = None
    job: Job | None = None
    retry_step: int = 0
    switch: Job | None = None
