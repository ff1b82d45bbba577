"""Triggers of a motion step: outputs that are switched at positions or instants on the way."""

from collections.abc import Iterable, Sequence
from itertools import pairwise
from typing import Annotated, Any

from pydantic import Field, field_validator, model_validator

from orchestrator.model.base import Model
from orchestrator.model.names import ALL_AXES
from orchestrator.model.numbers import MAX_DURATION_NS, Duration, parse_duration, split_number
from orchestrator.model.units import Quantity

MAX_TRIGGERS = 16  # of a step
MAX_PLACES = 10_000  # of one trigger
DEFAULT_PULSE_NS = 1_000_000
_TIME_UNITS = ("ns", "us", "µs", "ms", "s", "min", "h")


class Trigger(Model):
    """An output that a step switches on the way: every so far or so often, or at given positions or instants."""

    output: str = Field(description="controller.output")
    every: Quantity | None = Field(
        default=None,
        description='A distance of the axis `of`, e.g. "0.1 mm", counted from where it starts; or a duration, counted '
        'from the start, e.g. "10 ms".',
    )
    at: list[Quantity] | None = Field(
        default=None,
        min_length=1,
        max_length=MAX_PLACES,
        description="Positions of the axis `of`, at which it passes them; or durations from the start.",
    )
    of: str | None = Field(default=None, description="The axis of the step; without it, `every` and `at` are times.")
    pulse: Annotated[Duration, Field(gt=0)] | None = Field(
        default=None,
        description="How long the output is active each time, at least; 1 ms without it and without `level`. "
        "The trigger output of an SHRC-203 has 10 us.",
    )
    level: bool = Field(
        default=False, description="true: the output changes its level each time, first to active; no pulses."
    )

    @field_validator("output")
    @classmethod
    def _named(cls, value: str) -> str:
        if len(value.split(".")) != 2 or not all(value.split(".")):
            raise ValueError(f"{value!r} is not an output; write `controller.output`")
        return value

    @model_validator(mode="after")
    def _one_form(self) -> "Trigger":
        if (self.every is None) == (self.at is None):
            raise ValueError("needs either `every` or `at`")
        if self.level and self.pulse is not None:
            raise ValueError("has `level` and `pulse`; remove one of them")
        values = [self.every] if self.every is not None else self.at or []
        for value in values:
            _check_value(value, self.of)
        if self.of is None and self.at is not None and not _grows(self.instants_ns):
            raise ValueError("the instants in `at` must grow, each once")
        if self.every is not None and not _amount(self.every) > 0:
            raise ValueError(f"`every: {self.every}` must be above 0")
        return self

    @property
    def period_ns(self) -> int:
        """`every`, where it is a duration."""
        return parse_duration(self.every)

    @property
    def instants_ns(self) -> list[int]:
        """`at`, where it is durations."""
        return [parse_duration(value) for value in self.at or []]

    @property
    def pulse_ns(self) -> int:
        """How long a pulse lasts; 0: the output changes its level instead."""
        return 0 if self.level else self.pulse or DEFAULT_PULSE_NS


Triggers = Annotated[list[Trigger], Field(max_length=MAX_TRIGGERS)]


def _amount(value: int | float | str) -> float:
    parts = split_number(value) if isinstance(value, str) else (str(value), "")
    return float(parts[0]) if parts is not None else 0.0


def _check_value(value: int | float | str, of: str | None) -> None:
    """Raise `ValueError` for a distance without an axis, and for a duration of one."""
    parts = split_number(value) if isinstance(value, str) else (str(value), "")
    is_time = parts is not None and parts[1] in _TIME_UNITS
    if of is not None and is_time:
        raise ValueError(f'{value} is a time, and `of: {of}` asks for positions; remove `of`, or write e.g. "0.1 mm"')
    if of is None and not is_time:
        raise ValueError(f'{value} is not a time; write e.g. "10 ms", or name the axis of these positions with `of`')
    if of is None and parse_duration(value) > MAX_DURATION_NS:
        raise ValueError(f"{value} is too long")


def _grows(values: Sequence[int]) -> bool:
    return all(earlier_value < later_value for earlier_value, later_value in pairwise(values))


def check_step_triggers(triggers: Sequence[Trigger], axes: Iterable[str]) -> None:
    """Raise `ValueError` for triggers that a step with these axes cannot have."""
    known_axes, outputs = list(axes), set[str]()
    for number, trigger in enumerate(triggers):
        if trigger.output in outputs:
            raise ValueError(f"triggers.{number}: output {trigger.output} has two triggers; write one list in `at`")
        outputs.add(trigger.output)
        if trigger.of is not None and trigger.of not in known_axes and ALL_AXES not in known_axes:
            raise ValueError(
                f"triggers.{number}: axis {trigger.of} is not in the step; its axes are {', '.join(known_axes)}"
            )


def check_job_outputs(steps: Iterable[Any], outputs: Iterable[str]) -> None:
    """Raise `ValueError` for a trigger whose output the job switches itself. steps: of the job; outputs: that it
    switches."""
    switched_outputs = set(outputs)
    for number, step in enumerate(steps):
        for row, output in enumerate(step.trigger_outputs):
            if output in switched_outputs:
                name = f"triggers.{row}" if hasattr(step, "triggers") else "fly.trigger"
                raise ValueError(
                    f"steps.{number}.{name}: output {output} is switched by a step `do: output` of the job, too; use "
                    "another output, or remove that step"
                )
