"""Plans of Bluesky on the demo fleet, by ophyd-async devices of `integrations.bluesky`."""

import asyncio
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import bluesky.plan_stubs as bps
import bluesky.plans as bp
import h5py
import pytest
from bluesky import RunEngine
from bluesky.utils import FailedStatus, RunEngineInterrupted
from ecosystem.waits import wait_until
from ophyd_async.core import FlyMotorInfo, StaticFilenameProvider, StaticPathProvider, init_devices
from pages import read_blocks
from scanspec.specs import Fly, Linspace

from integrations.bluesky import FlightInfo, TuttiAxis, TuttiConnection, TuttiFlyer
from integrations.bluesky.flyer import make_scan
from tutti import Job, Refusal
from tutti.testing import LiveTestbed

ROOT = Path(__file__).parents[2]
Document = tuple[str, dict[str, Any]]


class Lab:
    """A RunEngine with devices of the demo fleet."""

    def __init__(self, fleet: LiveTestbed) -> None:
        self.fleet = fleet
        self.documents: list[Document] = []
        self.engine = RunEngine({}, context_managers=[])
        self.engine.subscribe(lambda name, document: self.documents.append((name, document)))
        self.connection = TuttiConnection(fleet.endpoint)
        with init_devices():
            x, y = TuttiAxis(self.connection, "gantry.x"), TuttiAxis(self.connection, "gantry.y")
            u = TuttiAxis(self.connection, "stage.u")
        self.x, self.y, self.u = x, y, u

    def run(self, plan: Any) -> None:
        self.documents.clear()
        self.engine(plan)

    def list_events(self, *keys: str) -> list[tuple[float, ...]]:
        events = [document for name, document in self.documents if name == "event"]
        return [tuple(event["data"][key] for key in keys) for event in events]

    def make_flyer(self, folder: Path) -> TuttiFlyer:
        provider = StaticPathProvider(StaticFilenameProvider("raster"), folder)
        with init_devices():
            flyer = TuttiFlyer(self.connection, provider)
        return flyer

    def call(self, coroutine: Any) -> Any:
        return asyncio.run_coroutine_threadsafe(coroutine, self.engine.loop).result(20)

    def wait_for_rest(self) -> None:
        wait_until(lambda: not any(axis.moving for axis in self.fleet.tutti.axes().values()))

    def close(self) -> None:
        self.call(self.connection.close())


@pytest.fixture
def lab(demo_fleet: LiveTestbed) -> Iterator[Lab]:
    lab = Lab(demo_fleet)
    yield lab
    lab.close()


def assert_near(events: list[tuple[float, ...]], wanted: list[tuple[float, ...]]) -> None:
    assert len(events) == len(wanted)
    for event, point in zip(events, wanted, strict=True):
        assert event == pytest.approx(point, abs=0.002)


def count_jobs(fleet: LiveTestbed) -> int:
    return len(fleet.tutti.list_jobs())


def test_a_grid_is_one_job_and_each_event_has_its_own_point(lab: Lab) -> None:
    jobs = count_jobs(lab.fleet)
    lab.run(bp.grid_scan([], lab.x, 20, 22, 3, lab.y, 10, 11, 3))
    wanted = [(x, y) for x in (20.0, 21.0, 22.0) for y in (10.0, 10.5, 11.0)]
    assert_near(lab.list_events("x", "y"), wanted)
    assert count_jobs(lab.fleet) == jobs + 1
    start = next(document for name, document in lab.documents if name == "descriptor")
    assert start["data_keys"]["x"]["units"] == "mm" and start["configuration"]["x"]["data"]["x-velocity"] > 0


@pytest.mark.nightly
def test_axes_of_two_makes_are_one_synchronised_move(lab: Lab) -> None:
    lab.run(bps.mv(lab.x, 30, lab.u, 3))
    entry = lab.fleet.tutti.list_jobs()[0]
    assert lab.fleet.tutti.position("gantry.x") == pytest.approx(30, abs=0.002)
    lab.run(bps.mv(lab.x, 31, lab.u, 4))  # within the same live job, which goes on for a second
    assert lab.fleet.tutti.list_jobs()[0].id == entry.id
    assert lab.call(lab.x.verdict.get_value()) in ("green", "amber")  # amber on a busy computer
    assert 0 < lab.call(lab.x.start_bound.get_value()) < 0.05


@pytest.mark.nightly
def test_an_axis_flies_at_constant_speed(lab: Lab) -> None:
    def fly() -> Any:
        info = FlyMotorInfo(start_position=40, end_position=60, time_for_move=1)
        yield from bps.open_run()
        yield from bps.prepare(lab.x, info, wait=True)
        yield from bps.kickoff(lab.x, wait=True)
        yield from bps.complete(lab.x, wait=True)
        yield from bps.close_run()

    lab.run(fly())
    assert lab.fleet.tutti.position("gantry.x") > 60


def fly_scan(flyer: TuttiFlyer, info: FlightInfo) -> Any:
    """Fly a scan; returns how long its flight took from kickoff to the last row, in s."""
    yield from bps.open_run()
    yield from bps.prepare(flyer, info, wait=True)
    yield from bps.declare_stream(flyer, name="flight", collect=True)
    begin_s = time.monotonic()
    yield from bps.kickoff(flyer, wait=True)
    yield from bps.collect_while_completing([flyer], [flyer], flush_period=0.1, stream_name="flight")
    duration_s = time.monotonic() - begin_s
    yield from bps.close_run()
    return duration_s


def test_a_scan_flies_and_its_rows_are_a_stream(lab: Lab, tmp_path: Path) -> None:
    spec = Fly(0.02 @ (Linspace(lab.x, 50, 51, 3) * ~Linspace(lab.y, 20, 30, 21)))
    flyer = lab.make_flyer(tmp_path)
    lab.run(fly_scan(flyer, FlightInfo(spec=spec, trigger={"output": "gantry.lamp"})))
    resources = {d["data_key"]: d for name, d in lab.documents if name == "stream_resource"}
    datums = [d for name, d in lab.documents if name == "stream_datum"]
    assert max(datum["indices"]["stop"] for datum in datums) == 63
    with h5py.File(tmp_path / "raster.h5") as file:
        column = file[resources["flyer-gantry_y"]["parameters"]["dataset"]]
        assert column.shape == (63,) and abs(column[1] - 20.5) < 0.02 and all(file["good"][:] == 1)
        assert 0 < file["t_hi"][0] - file["t_lo"][0] < 0.02 and abs(file["t_lo"][0] - time.time()) < 60


@pytest.mark.nightly
def test_a_flown_grid_takes_as_long_as_its_path(lab: Lab, tmp_path: Path) -> None:
    spec = Fly(0.02 @ (Linspace(lab.x, 50, 51, 20) * ~Linspace(lab.y, 20, 30, 20)))
    info = FlightInfo(spec=spec, trigger={"output": "gantry.lamp"})
    flyer = lab.make_flyer(tmp_path)
    durations = []

    def fly() -> Any:
        durations.append((yield from fly_scan(flyer, info)))

    lab.run(fly())
    [step] = lab.fleet.tutti.dry_run(Job("grid", [make_scan(info)[0]])).steps
    assert step.path is not None
    assert durations[0] < 1.05 * step.path.duration_s


@pytest.mark.parametrize("position", [1e4, float("nan")])
def test_a_position_outside_the_limits_moves_nothing(lab: Lab, position: float) -> None:
    jobs = count_jobs(lab.fleet)
    with pytest.raises(FailedStatus, match=r"soft limits|no position"):
        lab.run(bps.mv(lab.x, position, lab.y, 5))
    assert count_jobs(lab.fleet) <= jobs + 1 and lab.engine.state == "idle"


@pytest.mark.nightly
def test_an_abort_stops_and_a_pause_is_resumed(lab: Lab) -> None:
    lab.run(bps.mv(lab.x, 0))
    threading.Timer(0.4, lab.engine.request_pause).start()
    with pytest.raises(RunEngineInterrupted):
        lab.run(bp.scan([], lab.x, 0, 300, 3))
    lab.wait_for_rest()
    assert lab.fleet.tutti.position("gantry.x") < 299
    lab.engine.resume()
    assert_near(lab.list_events("x"), [(0,), (150,), (300,)])
    threading.Timer(0.4, lab.engine.abort).start()
    with pytest.raises(RunEngineInterrupted):
        lab.run(bps.mv(lab.x, 0))
    lab.wait_for_rest()
    assert lab.fleet.tutti.position("gantry.x") > 1


@pytest.mark.nightly
@pytest.mark.timeout(900)
def test_no_event_has_the_position_of_another_point(lab: Lab) -> None:
    for number in range(10):
        begin = 20 + number
        lab.run(bp.scan([], lab.x, begin, begin + 4.9, lab.u, 1, 5.9, 50))
        assert_near(lab.list_events("x", "u"), [(begin + k / 10, 1 + k / 10) for k in range(50)])


def test_the_page_runs(demo_fleet: LiveTestbed, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("TUTTI_CONNECT", demo_fleet.endpoint)
    names: dict[str, Any] = {"__name__": "page"}
    for block in read_blocks(ROOT / "docs/how-to/use-bluesky.md", "python"):
        exec(compile(block, "use-bluesky.md", "exec"), names)
    assert "stage_focus" in names
    asyncio.run_coroutine_threadsafe(names["lab"].close(), names["RE"].loop).result(20)


@pytest.mark.nightly
def test_two_engines_share_a_fleet_and_what_one_uses_the_other_is_refused(lab: Lab) -> None:
    other_lab = Lab(lab.fleet)
    try:
        other_lab.run(bps.mv(other_lab.u, 2))
        lab.run(bps.mv(lab.x, 10))
        with pytest.raises(FailedStatus, match="in use"):
            other_lab.run(bps.mv(other_lab.x, 11))
    finally:
        other_lab.close()


@pytest.mark.nightly
def test_an_estop_ends_a_plan_with_its_reason(lab: Lab) -> None:
    lab.run(bps.mv(lab.x, 0))
    threading.Timer(0.4, lambda: lab.fleet.tutti.estop("test")).start()
    with pytest.raises(FailedStatus, match="e-stop"):
        lab.run(bps.mv(lab.x, 300))
    lab.wait_for_rest()
    assert not any(lab.fleet.tutti.reset().values())
    lab.fleet.tutti.start_queue()
    enable_until_accepted(lab.fleet)
    lab.fleet.tutti.home()
    lab.run(bps.mv(lab.x, 5))


def enable_until_accepted(fleet: LiveTestbed) -> None:
    """Enable all axes: the coordinator may learn of a reset some ms after the program that has asked for it."""

    def is_accepted() -> bool:
        try:
            fleet.tutti.enable()
        except Refusal:
            return False
        return True

    wait_until(is_accepted)


@pytest.mark.parametrize(
    ("spec", "said"),
    [
        (Fly(0.02 @ Linspace("gantry.q", 0, 1, 5)), "gantry.q"),
        (Fly(0.02 @ (Linspace("gantry.x", 0, 300, 20_000) * Linspace("gantry.y", 0, 200, 1_000))), "20000000 points"),
        (Fly(0.02 @ Linspace("gantry.y", 0, 1e4, 11)), "gantry.y"),
        (Fly(Linspace("gantry.x", 0, 1, 5)), "duration"),
    ],
)
def test_a_spec_that_cannot_be_flown_is_refused_by_prepare(lab: Lab, tmp_path: Path, spec: Any, said: str) -> None:
    flyer = lab.make_flyer(tmp_path)
    with pytest.raises(FailedStatus, match=said):
        lab.run(bps.prepare(flyer, FlightInfo(spec=spec), wait=True))
    assert not list(tmp_path.iterdir())
    assert not any(axis.moving for axis in lab.fleet.tutti.axes().values())


@pytest.mark.nightly
def test_a_program_that_is_killed_before_its_kickoff_leaves_nothing_loaded(lab: Lab, tmp_path: Path) -> None:
    child = subprocess.Popen(
        [sys.executable, "-c", PREPARE_AND_WAIT, lab.fleet.endpoint, str(tmp_path)], stdout=subprocess.PIPE, text=True
    )
    assert child.stdout is not None and child.stdout.readline() == "prepared\n"
    child.kill()
    child.wait()
    wait_until(lambda: not any(entry.state in ("running", "armed") for entry in lab.fleet.tutti.list_jobs()))
    lab.run(bps.mv(lab.x, 50))


PREPARE_AND_WAIT = """
import sys, time
from pathlib import Path
from bluesky import RunEngine
import bluesky.plan_stubs as bps
from ophyd_async.core import StaticPathProvider, UUIDFilenameProvider, init_devices
from scanspec.specs import Fly, Linspace
from integrations.bluesky import FlightInfo, TuttiConnection, TuttiFlyer
RE = RunEngine()
lab = TuttiConnection(sys.argv[1])
with init_devices():
    flyer = TuttiFlyer(lab, StaticPathProvider(UUIDFilenameProvider(), Path(sys.argv[2])))
RE(bps.prepare(flyer, FlightInfo(spec=Fly(0.02 @ Linspace("gantry.y", 20, 30, 21))), wait=True))
print("prepared", flush=True)
time.sleep(600)
"""
