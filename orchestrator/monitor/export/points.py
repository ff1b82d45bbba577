"""The table of the points of scans: one row each; its columns are those of every format."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

from orchestrator.model.base import Model
from orchestrator.model.report import PointRecord
from orchestrator.monitor.export.table import DataTable

ColumnKind = Literal["whole", "number", "text", "flag"]
"""Of whole numbers, which are never missing; numbers, texts and flags may be."""

_MEASURED = "the last reading while the axis stood there; missing where it flew through, or left before the next one"
_PASSED = {
    "low": "the lowest position at the centre of `window_middle`",
    "high": "the highest position then",
}
_WINDOW_PARTS = {"lower": "the beginning of the window", "middle": "the point", "upper": "the end of the window"}


class PointColumn(NamedTuple):
    """A column. unit: empty: none. source: the field of a row that has its value, and of that its part."""

    name: str
    kind: ColumnKind
    unit: str
    meaning: str
    source: tuple[str | int, ...]

    def read_value(self, record: PointRecord) -> Any:
        """Its value of a row; None: the row has none."""
        value: Any = record
        for name in self.source:
            if isinstance(value, Model):
                value = getattr(value, str(name))
            else:
                value = value[name] if isinstance(name, int) else value.get(name)
            if value is None:
                break
        return value


def make_point_columns(units: Mapping[str, str]) -> list[PointColumn]:
    """The columns of a table of points. units: of its axes, in their order."""
    targets = [
        PointColumn(f"{axis} target", "number", unit, "where the axis was sent", ("target", axis))
        for axis, unit in units.items()
    ]
    positions = [
        PointColumn(f"{axis} measured", "number", unit, _MEASURED, ("measured", axis)) for axis, unit in units.items()
    ]
    intervals = [
        PointColumn(
            f"{axis} {bound}", "number", unit, f"of one that is flown: {meaning}", ("window", "positions", axis, number)
        )
        for axis, unit in units.items()
        for number, (bound, meaning) in enumerate(_PASSED.items())
    ]
    windows = [
        PointColumn(
            f"window_{part}_{bound}_ns",
            "number",
            "ns",
            f"when the axis that flies passed {meaning}, at the {bound}; fleet time",
            ("window", part, f"{bound}_ns"),
        )
        for part, meaning in _WINDOW_PARTS.items()
        for bound in ("earliest", "latest")
    ]
    return [
        PointColumn("step", "whole", "", "number of the first step of its scan, from 0", ("step",)),
        PointColumn("point", "whole", "", "number of the point in its scan, from 1", ("point",)),
        *targets,
        *positions,
        PointColumn("state", "text", "", "done, failed, skipped or stopped", ("state",)),
        PointColumn("verdict", "text", "", "green, amber, red or none", ("verdict",)),
        PointColumn("start_skew_least_ns", "number", "ns", "start skew, at least", ("start_skew", "at_least_ns")),
        PointColumn("start_skew_most_ns", "number", "ns", "start skew, at most", ("start_skew", "at_most_ns")),
        PointColumn("t0_fleet_ns", "number", "ns", "the agreed start of its move; fleet time", ("t0_fleet_ns",)),
        PointColumn(
            "took_s", "number", "s", "since the point before; of one that is flown, in its window", ("took_s",)
        ),
        PointColumn("good", "flag", "", "its line was done as planned; missing where the axes stop", ("good",)),
        *windows,
        *intervals,
    ]


def read_values(columns: Sequence[PointColumn], record: PointRecord) -> list[Any]:
    """The values of a row; None where it has none."""
    return [column.read_value(record) for column in columns]


def make_points_table(rows: Sequence[PointRecord], units: Mapping[str, str]) -> DataTable:
    """The points as a table, with the axes that they have. units: of these, as far as they are known."""
    axes = dict.fromkeys(axis for row in rows for axis in row.target)
    columns = make_point_columns({axis: units.get(axis, "") for axis in axes})
    return DataTable(
        "points",
        {column.name: [column.read_value(row) for row in rows] for column in columns},
        {column.name: column.unit for column in columns if column.unit},
    )
