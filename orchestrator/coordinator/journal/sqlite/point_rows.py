"""What was recorded at the points of scans: a row a point, written in batches, deleted with the job."""

import json
import sqlite3
from collections.abc import Sequence

from orchestrator.coordinator.journal.sqlite.transaction import DATABASE_ERRORS, Transaction, make_unusable_error
from orchestrator.model.report import PointRecord, SkewInterval

_COLUMNS = "step, point, state, verdict, t0_fleet_ns, skew_least_ns, skew_most_ns, took_s, target, measured"


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
            )
            for point in points
        ]
        with Transaction(self._db, self._path):
            self._db.executemany(f"INSERT OR REPLACE INTO point_rows VALUES ({', '.join('?' * 11)})", rows)

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
            )
            for step, point, state, verdict, t0_fleet_ns, least, most, took_s, target, positions in rows
        ]
