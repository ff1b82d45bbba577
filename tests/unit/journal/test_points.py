"""The store of points: quotas, damage, parts that broke off."""

import hashlib
from struct import pack

import pytest
from unit.journal.engines import Engine
from unit.journal.stored_points import AXES, NOON, later, make_points, store_points

from orchestrator.client.points import PART_BYTES
from orchestrator.coordinator.journal.records import DamagedRecord, JournalError
from orchestrator.coordinator.journal.sql.point_store import PointStore
from orchestrator.model.errors import Refusal
from orchestrator.model.steps.points import make_header


def test_points_come_back_from_any_part(engine: Engine) -> None:
    store = PointStore(engine.open_points())
    digest = store_points(store, 1000)
    assert store.read_rows(digest, 0, 2) == [(0.0, 0.0), (0.1, 1.0)]
    assert store.read_rows(digest, 95, 10) == [(k * 0.1, k % 7) for k in range(95, 105)]
    assert len(store.read_rows(digest, 990, 4096)) == 10
    columns = store.begin_upload(digest, AXES, 1000, NOON, []).columns
    assert columns is not None and (columns[0].most, columns[0].most_at) == (99.9, 1000)


def test_points_of_several_megabytes_come_in_parts_of_one(engine: Engine) -> None:
    db = engine.open_points()
    store = PointStore(db)
    digest = store_points(store, 200_000, part=PART_BYTES - PART_BYTES % 16)
    assert store.read_rows(digest, 199_998, 2) == [(each * 0.1, each % 7) for each in (199_998, 199_999)]
    ((parts, longest),) = db.select("SELECT count(*), max(length(data)) FROM parts WHERE digest = ?", (digest,))
    assert parts >= 4 and longest <= 1_000_000
    store.delete_upload(digest)
    assert db.select("SELECT count(*) FROM parts WHERE digest = ?", (digest,)) == [(0,)]


def test_an_upload_that_broke_off_is_continued_or_deleted_after_an_hour(engine: Engine) -> None:
    store = PointStore(engine.open_points())
    digest, rows = make_points(300)
    store.begin_upload(digest, AXES, 300, NOON, [])
    assert store.add_part(digest, 0, rows[:1600], NOON).received == 1600
    # A repeated part, and one after a gap, change nothing.
    assert store.add_part(digest, 0, rows[:1600], NOON).received == 1600
    assert store.add_part(digest, 3200, rows[3200:], NOON).received == 1600
    assert store.begin_upload(digest, AXES, 300, later(30), []).received == 1600
    store_points(store, 10)
    store.delete_unused([], later(89))
    assert store.used_bytes == 4800
    store.delete_unused([], later(91))
    assert store.used_bytes == 0
    with pytest.raises(Refusal, match="begin it again"):
        store.add_part(digest, 1600, rows[1600:], later(91))


def test_points_that_jobs_name_stay_and_count_against_the_quota(engine: Engine) -> None:
    store = PointStore(engine.open_points(), quota_bytes=10_000)
    kept = store_points(store, 600)
    digest, _ = make_points(100, 0.2)
    with pytest.raises(Refusal, match="the points need 1600 B; 9600 B of 10000 B for points are in use") as full:
        store.begin_upload(digest, AXES, 100, later(90), [kept])
    assert full.value.code == "point-store-full"
    # Without a job that names them they make room.
    assert store.begin_upload(digest, AXES, 100, later(90), []).received == 0


def test_points_that_are_not_those_announced_are_refused_and_deleted(engine: Engine) -> None:
    store = PointStore(engine.open_points())
    digest, rows = make_points(10)
    store.begin_upload(digest, AXES, 10, NOON, [])
    with pytest.raises(Refusal, match="are not those that were announced"):
        store.add_part(digest, 0, rows[::-1], NOON)
    endless = pack("<4d", 1.0, 2.0, 3.0, float("nan"))
    name = f"sha256:{hashlib.sha256(make_header(AXES) + endless).hexdigest()}"
    store.begin_upload(name, AXES, 2, NOON, [])
    with pytest.raises(Refusal, match=r"point 2: the position of stage\.u is nan"):
        store.add_part(name, 0, endless, NOON)
    assert store.used_bytes == 0


def test_a_bit_that_changed_on_the_disk_moves_nothing(engine: Engine) -> None:
    db = engine.open_points()
    store = PointStore(db)
    digest = store_points(store, 300)
    ((data,),) = db.select("SELECT data FROM parts WHERE begin = 1600")
    db.write("UPDATE parts SET data = ? WHERE begin = 1600", (data[:99] + bytes([data[99] ^ 1]) + data[100:],))
    assert len(store.read_rows(digest, 0, 100)) == 100
    with pytest.raises(DamagedRecord, match="have changed on the disk"):
        store.read_rows(digest, 100, 10)
    with pytest.raises(JournalError, match="are not stored any more"):
        store.read_rows(f"sha256:{'0' * 64}", 0, 1)
