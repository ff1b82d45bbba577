"""A pause."""

from typing import TYPE_CHECKING, Literal

from orchestrator.model.numbers import Duration
from orchestrator.model.steps.base import Step


class Dwell(Step):
    """Wait."""

    do: Literal["dwell"] = "dwell"
    duration: Duration

    if TYPE_CHECKING:

        def __init__(self, *, duration: str, name: str | None = None) -> None: ...

    @property
    def pause_ns(self) -> int:
        return self.duration
