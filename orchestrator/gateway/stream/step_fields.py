"""Steps in the frames of a socket: one by one as a person or a program asks for them."""

from pydantic import ValidationError

from orchestrator.gateway.stream.socket import Frame
from orchestrator.model.errors import Refusal
from orchestrator.model.problems import first_error_text
from orchestrator.model.steps.speed import MANUAL


def fill_speed(fields: Frame) -> Frame:
    """The fields of a step that was asked for by itself: a move has the manual speed of its axes, unless it states
    another one."""
    return {"speed": MANUAL, **fields} if fields.get("do") == "move" else fields


def refuse_fields(error: ValidationError, remedy: str = "see the steps of job files") -> Refusal:
    """The refusal of fields that are not valid."""
    return Refusal("bad-request", first_error_text(error).removeprefix("Value error, "), remedy)
