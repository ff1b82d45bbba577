"""Tables of points for tests of what stores them."""

import hashlib
from datetime import timedelta

import numpy as np

from orchestrator.coordinator.journal.sql.point_store import PointStore
from orchestrator.model.queue import format_utc, parse_utc
from orchestrator.model.steps.points import PointAxis, make_header
from orchestrator.model.units import Unit

AXES = [PointAxis(axis="gantry.x", unit=Unit.MM), PointAxis(axis="stage.u", unit=Unit.MM)]
NOON = "2026-11-26T12:00:00.000000Z"


def later(minutes: float) -> str:
    return format_utc(parse_utc(NOON) + timedelta(minutes=minutes))


def make_points(count: int, scale: float = 0.1) -> tuple[str, bytes]:
    rows = np.column_stack([np.arange(count) * scale, np.arange(count) % 7]).astype("<f8").tobytes()
    return f"sha256:{hashlib.sha256(make_header(AXES) + rows).hexdigest()}", rows


def store_points(store: PointStore, count: int, scale: float = 0.1, part: int = 1600) -> str:
    digest, rows = make_points(count, scale)
    state = store.begin_upload(digest, AXES, count, NOON, [])
    while state.columns is None:
        state = store.add_part(digest, state.received, rows[state.received : state.received + part], NOON)
    return digest
