"""Points of a scan that is written as a spec of scanspec 1.x (the optional extra `tutti[scanspec]`)."""

from collections.abc import Iterator, Mapping
from typing import Any, cast

import numpy as np

from orchestrator.model.errors import Refusal
from orchestrator.model.scans.point_summary import ROWS_AT_ONCE, Rows
from orchestrator.model.steps.points import MAX_POINTS, PointAxis
from orchestrator.model.units import Unit


class SpecPoints:
    """The points of a spec. units: of all axes of the fleet. Values are in the units of the axes."""

    def __init__(self, spec: Mapping[str, Any], units: Mapping[str, Unit]) -> None:
        """Raises `Refusal`: codes `no-scanspec` without the extra, `bad-scanspec`."""
        path_type, spec_type = import_scanspec()
        if contains_fly(spec):
            raise Refusal("bad-scanspec", "the spec has `Fly`, and points alone are stepped", "leave out `Fly`")
        try:
            scan_spec = spec_type.deserialize(dict(spec))
            self._path: Any = path_type(scan_spec.calculate(bounds=False))
            has_duration = scan_spec.duration() is not None
        except Exception as error:  # whatever another project raises for a spec that it cannot read
            raise Refusal("bad-scanspec", f"scanspec cannot read the spec: {error}", "correct the spec") from None
        if has_duration:
            text = "the spec has durations without `Fly`, which a scan of steps does not follow"
            raise Refusal("bad-scanspec", text, "add `Fly`, or remove them and put a dwell into `at_each`")
        names = [str(axis) for axis in scan_spec.axes()]
        unknown = [name for name in names if name not in units]
        if unknown:
            text = f"the fleet has no axis {', '.join(unknown)}; its axes are: {', '.join(units)}"
            raise Refusal("unknown-name", text, "name the axes of the spec as in the fleet file")
        if len(self._path) > MAX_POINTS:
            text = f"the spec has {len(self._path)} points; the maximum is {MAX_POINTS}"
            raise Refusal("bad-scanspec", text, "use several scans")
        self.axes = [PointAxis(axis=name, unit=units[name]) for name in names]

    def read_blocks(self) -> Iterator[Rows]:
        """The points, `ROWS_AT_ONCE` at a time."""
        while len(self._path):
            chunk = self._path.consume(ROWS_AT_ONCE)
            yield np.column_stack([chunk.midpoints[axis.axis] for axis in self.axes]).astype(np.float64)


def contains_fly(node: object) -> bool:
    """Whether a spec in its JSON form flies, or a part of it does."""
    if isinstance(node, Mapping):
        parts = cast(Mapping[str, object], node)
        return parts.get("type") == "Fly" or any(map(contains_fly, parts.values()))
    return isinstance(node, list) and any(map(contains_fly, cast(list[object], node)))


def import_scanspec() -> tuple[Any, Any]:
    """The classes `Path` and `Spec`. Raises `Refusal`, code `no-scanspec`."""
    try:
        from scanspec.core import Path  # pyright: ignore[reportMissingImports, reportUnknownVariableType]
        from scanspec.specs import Spec  # pyright: ignore[reportMissingImports, reportUnknownVariableType]
    except ImportError:
        text = "a scan is written as a scanspec, and scanspec is not installed here"
        raise Refusal("no-scanspec", text, "pip install 'tutti[scanspec]'; or write `axes` or `points`") from None
    return Path, Spec  # pyright: ignore[reportUnknownVariableType]
