"""What was recorded at the points of scans: a row a point, written in batches, deleted with the job."""

import json
from collections.abc import Sequence
from typing import Any

from orchestrator.coordinator.journal.sql.database import JournalPart, make_upsert
from orchestrator.model.report import PointRecord, PointWindow, SkewInterval

_COLUMNS = "step, point, state, verdict, t0_fleet_ns, skew_least_ns, skew_most_ns, took_s, target, measured, flown"

_STORE = make_upsert("point_rows", ("job_id", "step", "point"), _COLUMNS.split(", ")[2:])


class PointRows(JournalPart):
    """`PointRowStore`: the recorded points in the journal's database."""

    def store_points(self, job_id: str, points: Sequence[PointRecord]) -> None:
        rows = [
            (
                job_id,
                point.step,
                point.point,
                point.state,
                point.verdict,
                point.t0_fleet_ns,
                point.start_skew.at_least_ns if point.start_skew else None,
                point.start_skew.at_most_ns if point.start_skew else None,
                point.took_s,
                json.dumps(point.target),
                json.dumps(point.measured),
                _encode_flown(point),
            )
            for point in points
        ]
        with self._db.transaction():
            self._db.write_many(_STORE, rows)

    def load_points(self, job_id: str, after: tuple[int, int], limit: int) -> list[PointRecord]:
        condition = "job_id = ? AND (step, point) > (?, ?) ORDER BY step, point LIMIT ?"
        query = f"SELECT {_COLUMNS} FROM point_rows WHERE {condition}"
        return [
            PointRecord(
                step=step,
                point=point,
                state=state,
                verdict=verdict,
                t0_fleet_ns=t0_fleet_ns,
                start_skew=None if least is None else SkewInterval(at_least_ns=least, at_most_ns=most),
                took_s=took_s,
                target=json.loads(target),
                measured=json.loads(positions),
                **_decode_flown(flown_text),
            )
            for (
                step,
                point,
                state,
                verdict,
                t0_fleet_ns,
                least,
                most,
                took_s,
                target,
                positions,
                flown_text,
            ) in self._db.select(query, (job_id, *after, limit))
        ]


def _encode_flown(point: PointRecord) -> str | None:
    """What only a scan that flies has, as JSON."""
    if point.good is None:
        return None
    return json.dumps([point.good, None if point.window is None else point.window.to_plain()])


def _decode_flown(text: str | None) -> dict[str, Any]:
    if text is None:
        return {}
    good, window = json.loads(text)
    return {"good": good, "window": None if window is None else PointWindow.model_validate(window)}
