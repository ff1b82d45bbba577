"""A pause."""

from typing import TYPE_CHECKING, Literal

from pydantic import Field

from orchestrator.model.numbers import Duration
from orchestrator.model.steps.base import Step


class Dwell(Step):
    """Wait."""

    do: Literal["dwell"] = "dwell"
    duration: Duration
    since_begin: bool = Field(
        default=False,
        exclude_if=lambda since_begin: not since_begin,
        description="true: until so long after the job has begun, for what repeats at instants; it does not wait if "
        "that is past.",
    )

    if TYPE_CHECKING:

        def __init__(self, *, duration: str, since_begin: bool = False, name: str | None = None) -> None: ...

    @property
    def pause_ns(self) -> int | None:
        return None if self.since_begin else self.duration
