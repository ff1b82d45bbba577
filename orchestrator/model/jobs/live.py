"""Requests of the program of a live job, and what became of the steps that it asked for."""

from pydantic import Field, field_validator

from orchestrator.model.base import Int53, Model
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import JobReference
from orchestrator.model.messages import Reply
from orchestrator.model.queue import MAX_FLAT_STEPS
from orchestrator.model.report import StepReport
from orchestrator.model.steps.armed_terms import check_armed_waits
from orchestrator.model.steps.live import MAX_AHEAD, AskedStep

KEPT_RESULTS = 2 * MAX_AHEAD
"""Results of the newest steps that the coordinator and a program keep, because one may be lost on the way."""


class AskLive(JobReference):
    """Ask a running live job for steps: they run one after the other behind those that wait, or, where moves are
    gathered, together."""

    steps: list[AskedStep] = Field(min_length=1, max_length=MAX_AHEAD)

    @field_validator("steps")
    @classmethod
    def _waits_before_motions(cls, steps: list[AskedStep]) -> list[AskedStep]:
        check_armed_waits(steps)
        return steps


class LiveAsked(Reply):
    """The number of each step, from 0: that of its result, and of its row in the record of the job."""

    numbers: list[Int53] = Field(default=[])


class ReadLive(JobReference):
    """What became of step `number` of a live job."""

    number: int = Field(ge=0, le=MAX_FLAT_STEPS)


class LiveResult(Model):
    """What became of a step that a live job was asked for; on the bus as soon as it has ended. state `skipped`: it was
    not begun, because one before it was not done."""

    job_id: str
    number: Int53
    report: StepReport


class LiveRead(Reply):
    """None: the step has not ended yet."""

    result: LiveResult | None = None


def require_room(waiting: int, more: int) -> None:
    """Raise `Refusal`, code `too-many`, where `more` steps cannot be added to those that wait."""
    if waiting + more > MAX_AHEAD:
        text = f"{waiting} moves wait already, and {more} more were asked for; at most {MAX_AHEAD} may wait"
        raise Refusal("too-many", text, "wait for the end of a move before the next ones are asked for")
