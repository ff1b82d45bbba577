"""A repeat: steps run several times. With it the list of kinds is complete."""

from collections.abc import Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Annotated, Literal, Self

from pydantic import Field, model_validator

from orchestrator.model.steps.armed_terms import check_armed_waits
from orchestrator.model.steps.base import InnerSteps, Step, TargetResolver
from orchestrator.model.steps.kinds import SingleStep
from orchestrator.model.steps.points import MAX_POINTS

MAX_REPEATED = 200  # steps inside a repeat, those at the points of its scans included
MAX_REPEAT_DEPTH = 3  # of repeats inside each other


class Repeat(Step):
    """Run steps several times."""

    do: Literal["repeat"] = "repeat"
    times: int = Field(ge=1, le=MAX_POINTS)
    steps: list["JobStep"] = Field(min_length=1, max_length=MAX_REPEATED)

    if TYPE_CHECKING:

        def __init__(self, *, times: int, steps: Sequence["Step"], name: str | None = None) -> None: ...

    @model_validator(mode="after")
    def _bounded(self) -> "Repeat":
        if self.depth > MAX_REPEAT_DEPTH:
            raise ValueError(f"repeats are nested more than {MAX_REPEAT_DEPTH} deep; write the innermost ones out")
        check_armed_waits(self.steps)
        count = sum(1 for _ in self.iterate_written())
        if count > MAX_REPEATED:
            raise ValueError(f"has {count} steps inside; the maximum is {MAX_REPEATED}")
        if any(step.is_open for step in self.iterate_written()):
            raise ValueError("a live step runs until its program ends it, and cannot be repeated")
        return self

    @property
    def depth(self) -> int:
        """How deep repeats are nested in it, itself included."""
        return 1 + max((step.depth for step in self.steps if isinstance(step, Repeat)), default=0)

    @property
    def inner(self) -> InnerSteps:
        return InnerSteps("steps", self.steps, self.times, "in pass")

    @property
    def is_single(self) -> bool:
        return False

    @property
    def step_count(self) -> int:
        return self.times * sum(step.step_count for step in self.steps)

    @property
    def report_count(self) -> int:
        return self.times * sum(step.report_count for step in self.steps)

    def iterate_written(self) -> Iterator[Step]:
        for step in self.steps:
            yield from step.iterate_written()

    def replace_steps(self, replacements: Mapping[int, Step]) -> Step:
        steps = [step.replace_steps(replacements) for step in self.steps]
        is_same = all(new is old for new, old in zip(steps, self.steps, strict=True))
        return self if is_same else self.model_copy(update={"steps": steps})

    def resolve_targets(self, resolver: TargetResolver) -> Self:
        return self.model_copy(update={"steps": [resolver.resolve_step(step) for step in self.steps]})

    def complete_words(self, fields: list[str]) -> list[str]:
        return [f"{self.times} times: {len(self.steps)} step{'' if len(self.steps) == 1 else 's'}"]


JobStep = Annotated[SingleStep | Repeat, Field(discriminator="do")]
"""A step as a job file has it: one of the kinds, by its `do`."""

Repeat.model_rebuild()
