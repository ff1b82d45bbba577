"""The job file: a list of steps for the whole fleet."""

from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import ConfigDict, Field, field_validator, model_validator

from orchestrator.model.numbers import Duration
from orchestrator.model.script import ScriptModel
from orchestrator.model.steps.armed_terms import check_armed_waits
from orchestrator.model.steps.base import Step, require_in_files
from orchestrator.model.steps.measured import find_measure_problem
from orchestrator.model.steps.repeat import JobStep
from orchestrator.model.steps.tree import iterate_steps
from orchestrator.model.steps.triggers import check_job_outputs
from orchestrator.model.text.text_fields import PLAIN_TEXT, SHOW_TEXT

UNKNOWN_ACTOR = "unknown"
_MISSING: Any = object()

ParameterText = Annotated[str, SHOW_TEXT, Field(max_length=120)]


class Job(ScriptModel):
    """A sequence of steps that a user submits to the fleet.

    In Python: `Job("scan", [Home(), Move(to={"gantry.x": 120, "stage.u": "6 mm"})], max_start_skew="5 ms")`; skews and
    durations are text with a unit. Raises `WrongValue` with every mistake.
    """

    model_config = ConfigDict(json_schema_extra=require_in_files("schema"))

    schema_: Literal["tutti.job/1"] = Field(default="tutti.job/1", alias="schema")
    name: Annotated[str, PLAIN_TEXT] = Field(min_length=1, max_length=120)
    actor: Annotated[str, SHOW_TEXT] = Field(
        default=UNKNOWN_ACTOR, min_length=1, max_length=80, description="The user or program that submits the job."
    )
    max_start_skew: Duration = Field(default=10_000_000, description="Maximum spread of the axes' starts.")
    max_end_skew: Duration | None = Field(
        default=None,
        description="Maximum spread of the axes' ends. Without it, durations must match within 20 ms, apart from "
        "clock error.",
    )
    max_path_skew: Duration | None = Field(
        default=None, description="Maximum time offset between axes along their path."
    )
    parameters_used: dict[str, ParameterText] = Field(
        default={},
        max_length=100,
        description="The parameters of the template that the job was made of, with their values; they are written "
        "there when it is filled, and change nothing.",
    )
    steps: list[JobStep] = Field(min_length=1, max_length=10_000)

    def __init__(self, name: str = _MISSING, steps: Sequence[Step] = _MISSING, **fields: Any) -> None:
        values = {"name": name, "steps": steps}
        super().__init__(**{key: value for key, value in values.items() if value is not _MISSING}, **fields)

    # Validation fills the fields itself, as for a model without a constructor of its own.
    __init__.__pydantic_base_init__ = True  # pyright: ignore[reportFunctionMemberAccess]

    @model_validator(mode="after")
    def _separate_outputs(self) -> "Job":
        check_armed_waits(self.steps)
        steps = list(iterate_steps(self.steps))
        check_job_outputs(steps, (output for step in steps for output in step.switched_outputs))
        return self

    @model_validator(mode="after")
    def _measured_before(self) -> "Job":
        probed_axes: dict[str, str] = {}
        for step in iterate_steps(self.steps):
            for axis, target in step.measured_targets.items():
                problem = find_measure_problem(axis, target, probed_axes)
                if problem and not self.is_open:
                    raise ValueError(f"{step.describe()}: {problem}")
            probed_axes |= step.contact_names
        return self

    @model_validator(mode="after")
    def _saved_for_later(self) -> "Job":
        saved_names: set[str] = set()
        for step in iterate_steps(self.steps):
            for axis, target in step.iterate_targets():
                if target in saved_names:
                    text = f"{target} is saved by a step before it, and is taken once, when the job begins"
                    remedy = f"write `{{{axis}: {{of: PROBE.axis}}}}`, or use it in a later job"
                    raise ValueError(f"{step.describe()}: {text}; {remedy}")
            if step.saved_position is not None:
                saved_names.add(step.saved_position)
        return self

    @model_validator(mode="after")
    def _open_alone(self) -> "Job":
        number = next((number for number, step in enumerate(self.steps) if step.is_open), None)
        if number is not None and len(self.steps) > 1:
            raise ValueError(
                f"steps[{number}]: a live step ends with the program that asks for its moves, so it stands alone in "
                "its job; ask for the other steps there"
            )
        return self

    @property
    def is_open(self) -> bool:
        """Whether its steps are asked for while it runs."""
        return self.steps[0].is_open

    @field_validator("max_start_skew", "max_end_skew", "max_path_skew")
    @classmethod
    def _above_zero(cls, value: int | None) -> int | None:
        if value is not None and value <= 0:
            raise ValueError("must be above 0")
        return value
