"""What was recorded at the points of scans: a row a point, written in batches, deleted with the job."""

import json
import sqlite3
from collections.abc import Sequence
from typing import Any

from orchestrator.coordinator.journal.sqlite.transaction import DATABASE_ERRORS, Transaction, make_unusable_error
from orchestrator.model.report import PointRecord, PointWindow, SkewInterval

_COLUMNS = "step, point, state, verdict, t0_fleet_ns, skew_least_ns, skew_most_ns, took_s, target, measured, flown"


class PointRows:
    """`PointRowStore`: the recorded points in the journal's database."""

    def __init__(self, db: sqlite3.Connection, path: str) -> None:
        self._db = db
        self._path = path

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
        with Transaction(self._db, self._path):
            self._db.executemany(f"INSERT OR REPLACE INTO point_rows VALUES ({', '.join('?' * 12)})", rows)

    def load_points(self, job_id: str, after: tuple[int, int], limit: int) -> list[PointRecord]:
        condition = "job_id = ? AND (step, point) > (?, ?) ORDER BY step, point LIMIT ?"
        query = f"SELECT {_COLUMNS} FROM point_rows WHERE {condition}"
        try:
            rows = self._db.execute(query, (job_id, *after, limit)).fetchall()
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._path, error) from None
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
            for step, point, state, verdict, t0_fleet_ns, least, most, took_s, target, positions, flown_text in rows
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
