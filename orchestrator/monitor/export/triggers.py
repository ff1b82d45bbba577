"""The table of outputs that were switched on the way: one row for each instant of each trigger."""

from typing import Any

from orchestrator.monitor.export.recorded import RecordedRun
from orchestrator.monitor.export.table import DataTable, make_table

COLUMNS = (
    "step",
    "output",
    "number",
    "planned_ns",
    "promised_t_lo_ns",
    "promised_t_hi_ns",
    "seen_t_lo_ns",
    "seen_t_hi_ns",
)
UNITS = {column: "ns" for column in COLUMNS if column.endswith("_ns")}


def make_triggers_table(run: RecordedRun) -> DataTable:
    """Each instant asked for, the interval promised for its edge, and the one in which it was seen, fleet time; of each
    axis of a step the positions (`AXIS.lo`, `AXIS.hi`, motor positions) between which it was then."""
    rows: list[dict[str, Any]] = []
    axes: dict[str, None] = {}
    for message in run.triggers:
        for row in message.rows:
            columns: dict[str, Any] = {
                "step": message.step,
                "output": message.output,
                "number": row.number,
                "planned_ns": row.planned_ns,
                "promised_t_lo_ns": row.earliest_ns,
                "promised_t_hi_ns": row.latest_ns,
            }
            if row.seen is not None:
                columns |= {"seen_t_lo_ns": row.seen.earliest_ns, "seen_t_hi_ns": row.seen.latest_ns}
            for axis, interval in row.positions.items():
                axes |= {f"{axis}.lo": None, f"{axis}.hi": None}
                columns |= {f"{axis}.lo": interval.least, f"{axis}.hi": interval.most}
            rows.append(columns)
    return make_table("triggers", rows, (*COLUMNS, *axes), UNITS)
