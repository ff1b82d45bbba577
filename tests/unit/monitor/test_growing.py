"""A table of points in an HDF5 file that grows: what readers see meanwhile, and what is left after every kind of end."""

import fcntl
import os
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import h5py
import numpy as np
import pytest

from orchestrator.model.report import PointRecord, PointWindow, SkewInterval
from orchestrator.model.state import TimeInterval
from orchestrator.monitor.export.dataframe import make_dataframe
from orchestrator.monitor.export.growing import BROKEN_OFF, COMPLETE, GROWS, GrowingTable, NoFileLocks
from orchestrator.monitor.export.points import make_point_columns, make_points_table, read_values

UNITS = {"gantry.x": "mm", "stage.u": "um"}
COLUMNS = make_point_columns(UNITS)
WINDOW = PointWindow(
    lower=TimeInterval(earliest_ns=2**52 + 1, latest_ns=2**52 + 2),
    middle=TimeInterval(earliest_ns=2**52 + 3, latest_ns=2**52 + 4),
    upper=TimeInterval(earliest_ns=2**52 + 5, latest_ns=2**52 + 6),
)


def stepped(point: int) -> PointRecord:
    return PointRecord(
        step=2,
        point=point,
        state="done",
        verdict="green",
        start_skew=SkewInterval(at_least_ns=1, at_most_ns=2),
        took_s=0.5,
        target={"gantry.x": point, "stage.u": 1},
        measured={"gantry.x": point + 0.001, "stage.u": None},
    )


def flown(point: int) -> PointRecord:
    target = {"gantry.x": float(point)}
    window, t0_ns = WINDOW, 2**53 - 1
    return PointRecord(
        step=9,
        point=point,
        state="done",
        verdict="amber",
        target=target,
        measured=dict.fromkeys(target),
        window=window,
        good=True,
        t0_fleet_ns=t0_ns,
    )


def values(*records: PointRecord) -> list[Sequence[Any]]:
    return [read_values(COLUMNS, record) for record in records]


def open_table(path: Path, *, force: bool = False) -> GrowingTable:
    return GrowingTable(path, COLUMNS, {"job_id": "a1", "fleet": "lab"}, force=force)


def read(path: Path, *, swmr: bool = False) -> tuple[int, int, dict[str, Any]]:
    """Rows, status, and the columns as far as they are complete."""
    with h5py.File(path, "r", swmr=swmr) as file:
        opened: Any = file
        count = int(opened["rows"][0])
        columns = {name: opened["points"][name][:count] for name in opened["points"]}
        return count, int(opened["status"][0]), columns


def test_every_field_of_a_row_has_a_column() -> None:
    assert {column.source[0] for column in COLUMNS} == set(PointRecord.model_fields)
    assert len({column.name for column in COLUMNS}) == len(COLUMNS)


def test_a_reader_sees_whole_rows_while_the_file_grows(tmp_path: Path) -> None:
    path = tmp_path / "p.h5"
    table = open_table(path)
    with h5py.File(path, "r", swmr=True) as file:
        opened: Any = file
        assert dict(file.attrs) == {"job_id": "a1", "fleet": "lab"}
        count = 0
        for size in (1, 3, 600, 2000):
            table.add_rows(values(*(stepped(count + k + 1) for k in range(size))))
            count += size
            opened["rows"].refresh()
            assert opened["rows"][0] == count
            for name in opened["points"]:
                opened["points"][name].refresh()
                assert len(opened["points"][name]) == count
            assert list(opened["points/point"]) == list(range(1, count + 1))
            assert list(opened["points/gantry.x measured"])[-1] == count + 0.001
        assert opened["status"][0] == GROWS
        table.close(complete=True)
        opened["status"].refresh()
        assert opened["status"][0] == COMPLETE
    # It is closed: any program can read it, and it has no more room than it needs.
    assert read(path)[:2] == (2604, COMPLETE)
    assert path.stat().st_size < 2604 * sum(8 for _ in COLUMNS) * 2


def test_values_have_units_and_what_is_missing_is_marked(tmp_path: Path) -> None:
    path = tmp_path / "p.h5"
    table = open_table(path)
    table.add_rows(values(stepped(1), flown(2)))
    table.close(complete=True)
    _, _, columns = read(path)
    assert list(columns["step"]) == [2, 9] and list(columns["verdict"]) == [b"green", b"amber"]
    assert np.isnan(columns["stage.u measured"]).all() and list(columns["good"]) == [-1, 1]
    # Fleet time is below 2^53: doubles have every nanosecond of it.
    assert (
        columns["window_middle_earliest_ns"][1] == WINDOW.middle.earliest_ns and columns["t0_fleet_ns"][1] == 2**53 - 1
    )
    assert np.isnan(columns["took_s"][1]) and np.isnan(columns["window_upper_latest_ns"][0])
    with h5py.File(path) as file:
        opened: Any = file
        assert opened["points/stage.u target"].attrs["units"] == "um"
        assert opened["points/took_s"].attrs["units"] == "s" and opened["points/good"].attrs["missing"] == "-1"
        assert all(opened["points"][column.name].attrs["meaning"] for column in COLUMNS)


def test_a_file_that_is_there_is_replaced_only_by_force_and_its_readers_keep_it(tmp_path: Path) -> None:
    path = tmp_path / "p.h5"
    first = open_table(path)
    first.add_rows(values(stepped(1)))
    with pytest.raises(FileExistsError):
        open_table(path)
    with h5py.File(path, "r", swmr=True) as file:
        opened: Any = file
        second = open_table(path, force=True)
        second.add_rows(values(stepped(7), stepped(8)))
        first.add_rows(values(stepped(2)))
        opened["points/point"].refresh()
        assert list(opened["points/point"]) == [1, 2]
        first.close(complete=True)
    second.close(complete=False)
    second.close(complete=True)  # the second time it does nothing
    assert read(path)[:2] == (2, BROKEN_OFF) and list(read(path)[2]["point"]) == [7, 8]
    assert [each.name for each in tmp_path.iterdir()] == ["p.h5"]


def test_what_cannot_be_made_leaves_nothing(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError):
        open_table(tmp_path / "none" / "p.h5")
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError):
        open_table(tmp_path / "folder", force=True)
    with (tmp_path / "p.h5.new").open("w") as other:
        fcntl.flock(other, fcntl.LOCK_SH)
        with pytest.raises(NoFileLocks, match=r"p\.h5 cannot be locked"):
            open_table(tmp_path / "p.h5", force=True)
    assert [each.name for each in tmp_path.iterdir()] == ["folder"]


# In a process of its own: with a limit on the size of its files, or killed.
PROGRAM = """
import os, resource, signal, sys
from pathlib import Path
from unit.monitor.test_growing import open_table, stepped, values

table = open_table(Path(sys.argv[1]))
if sys.argv[2] == "full":
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    resource.setrlimit(resource.RLIMIT_FSIZE, (1_200_000, 1_200_000))
try:
    for point in range(1, 5001, 20):
        table.add_rows(values(*map(stepped, range(point, point + 20))))
except OSError as error:
    table.close(complete=False)
    print(table.row_count, error.strerror)
if sys.argv[2] == "killed":
    os._exit(9)
"""


def run_writer(path: Path, how: str) -> subprocess.CompletedProcess[str]:
    root = Path(__file__).parents[3]
    environment = os.environ | {"PYTHONPATH": f"{root}{os.pathsep}{root / 'tests'}"}
    return subprocess.run(
        [sys.executable, "-c", PROGRAM, str(path), how], env=environment, capture_output=True, text=True, check=False
    )


def test_a_full_disk_leaves_a_closed_file_with_the_rows_so_far(tmp_path: Path) -> None:
    done = run_writer(tmp_path / "p.h5", "full")
    assert (done.returncode, done.stderr) == (0, "")
    written, _, text = done.stdout.partition(" ")
    assert text == "File too large\n" and 1000 < int(written) < 5000
    count, status, columns = read(tmp_path / "p.h5")
    assert (count, status) == (int(written), BROKEN_OFF) and columns["point"][-1] == count


def test_the_rows_of_a_writer_that_was_killed_can_be_read(tmp_path: Path) -> None:
    assert run_writer(tmp_path / "p.h5", "killed").returncode == 9
    count, status, columns = read(tmp_path / "p.h5", swmr=True)
    assert (count, status) == (5000, GROWS) and columns["point"][-1] == 5000


@pytest.mark.parametrize("library", ["pandas", "polars"])
def test_points_are_a_data_frame(library: str) -> None:
    frame = make_dataframe(make_points_table([stepped(1), flown(2)], UNITS), library)
    assert list(frame["point"]) == [1, 2] and list(frame["window_middle_latest_ns"])[1] == WINDOW.middle.latest_ns
    assert next(iter(frame["gantry.x measured"])) == 1.001


def test_the_example_prints_points_as_they_come_and_ends_with_the_file(tmp_path: Path) -> None:
    example = Path(__file__).parents[3] / "deploy" / "examples" / "read_growing_hdf5.py"
    path = tmp_path / "p.h5"
    table = open_table(path)
    command = [sys.executable, str(example), str(path)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as reader:
        assert reader.stdout is not None and reader.stderr is not None
        head = reader.stdout.readline().split(",")
        assert head[0] == "point" and set(head[1:3]) == {"gantry.x target", "gantry.x measured"}
        for point in (1, 2, 3):
            table.add_rows(values(stepped(point)))
            # It shows each one before the next is written.
            assert reader.stdout.readline().startswith(f"{point},")
        table.add_rows(values(*map(stepped, range(4, 1001))))
        table.close(complete=True)
        lines = reader.stdout.read().splitlines()
        assert len(lines) == 997 and lines[-1].startswith("1000,") and lines[-1].endswith(",green")
        assert reader.stderr.read() == "1000 points; complete\n" and reader.wait() == 0
    late = subprocess.run([*command, "0.1"], capture_output=True, text=True, check=True)
    assert len(late.stdout.splitlines()) == 1001
    none = subprocess.run([*command[:2], str(tmp_path / "q.h5"), "0.1"], capture_output=True, text=True, check=False)
    assert none.returncode == 1 and "has not come within 0.1 s" in none.stderr and "Traceback" not in none.stderr
