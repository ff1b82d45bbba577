"""Targets that earlier steps of a job measure: the contact of a probe, or the middle of two."""

from collections.abc import Iterable, Mapping
from typing import Annotated, Any, cast

from pydantic import BeforeValidator, Field

from orchestrator.model.base import Model
from orchestrator.model.names import split_name
from orchestrator.model.units import AxisQuantity

MAX_MEASURED = 2


def _read_names(of: object) -> object:
    return [of] if isinstance(of, str) else of


class MeasuredTarget(Model):
    """A position that probes before it have measured: `{of: EDGE.z, plus: 5 mm}`."""

    of: Annotated[list[str], BeforeValidator(_read_names)] = Field(
        min_length=1,
        max_length=MAX_MEASURED,
        description="`NAME.axis`: the contact of the probe with that name; of two such names the middle.",
    )
    plus: AxisQuantity = Field(default=0, description="What is added to it.")
    between: Annotated[list[AxisQuantity], Field(min_length=2, max_length=2)] | None = Field(
        default=None,
        description="The bounds of the target, or nothing moves; by default those of the probe's way, plus `plus`.",
    )

    def describe(self) -> str:
        """`EDGE.z + 5 mm`."""
        text = f"the middle of {' and '.join(self.of)}" if len(self.of) > 1 else self.of[0]
        return text if self.plus in (0, 0.0) else f"{text} + {self.plus}"


def split_measured(fields: Any, key: str) -> Any:
    """Fields of a step with what is measured apart from the quantities in its field `key`."""
    if not isinstance(fields, Mapping):
        return cast("object", fields)
    plain_fields = cast("Mapping[str, object]", fields)
    targets = plain_fields.get(key)
    if not isinstance(targets, Mapping):
        return plain_fields
    items = cast("Mapping[str, object]", targets).items()
    measured_items: dict[str, object] = {
        name: value for name, value in items if isinstance(value, dict | MeasuredTarget)
    }
    if not measured_items:
        return plain_fields
    stated_items = cast("Mapping[str, object]", plain_fields.get("measured") or {})
    plain_items = {name: value for name, value in items if name not in measured_items}
    return {**plain_fields, key: plain_items, "measured": {**stated_items, **measured_items}}


def name_contacts(name: str | None, axes: Iterable[str]) -> dict[str, str]:
    """How later steps name the contact of a probe, and its axis: `EDGE.z`, `EDGE.gantry.z`."""
    if name is None:
        return {}
    return {text: axis for axis in axes for text in (f"{name}.{split_name(axis)[1]}", f"{name}.{axis}")}


def find_measure_problem(axis: str, target: MeasuredTarget, probed: Mapping[str, str]) -> str:
    """Why a target cannot be measured; empty if it can. probed: the axes of the probes before it, by their names."""
    for name in target.of:
        if name not in probed:
            names = ", ".join(_list_short(probed)) or "none"
            return f"{name} names no probe before it; probes with names: {names}"
        if probed[name] != axis:
            return f"{name} is measured with {probed[name]}, and is no position of {axis}"
    return ""


def _list_short(names: Iterable[str]) -> list[str]:
    return [name for name in names if name.count(".") == 1]


MEASURED: Any = Field(
    default_factory=dict[str, MeasuredTarget],
    exclude_if=lambda targets: not targets,
    description="Targets by axis that earlier probes measure; they are written among the others: "
    "`{of: EDGE.z, plus: 5 mm}`.",
)
