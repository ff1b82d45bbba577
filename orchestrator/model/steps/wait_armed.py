"""The motion behind it is loaded, and waits for a request or an input."""

from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field

from orchestrator.model.numbers import Duration
from orchestrator.model.steps.armed_terms import ArmedTerms
from orchestrator.model.steps.base import Step


class WaitArmed(Step):
    """Plan and load the move or path directly behind it in all its controllers, and start that on `tutti job go`, or
    when an input becomes active. A scan that flies waits at the beginning of its first line."""

    do: Literal["wait_armed"] = "wait_armed"
    input: str | None = Field(default=None, description="controller.input; without one, only a request starts it.")
    value: bool = Field(default=True, description="true: it starts when the input becomes active.")
    level: bool = Field(
        default=False, description="Start at once if the input has that value already; otherwise that is refused."
    )
    timeout: Annotated[Duration, Field(gt=0)] = Field(
        default=60_000_000_000, description="The end of the wait: then nothing moves, and the job fails."
    )

    if TYPE_CHECKING:

        def __init__(
            self,
            *,
            input: str | None = None,
            value: bool = True,
            level: bool = False,
            timeout: str = "60 s",
            name: str | None = None,
        ) -> None: ...

    @property
    def awaited_inputs(self) -> list[str]:
        return [] if self.input is None else [self.input]

    @property
    def armed_terms(self) -> ArmedTerms:
        return ArmedTerms(self.input, self.value, self.level, self.timeout)
