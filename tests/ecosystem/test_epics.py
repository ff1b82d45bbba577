"""Clients of EPICS drive the demo fleet: ophyd-async's `Motor`, p4p and aioca, none of them changed."""

import asyncio
import threading
from collections.abc import Iterator
from typing import Any

import bluesky.plan_stubs as bps
import bluesky.plans as bp
import pytest
from aioca import purge_channel_caches
from bluesky import RunEngine
from bluesky.utils import FailedStatus, RunEngineInterrupted
from ecosystem.epics_server import CA_PORT, PVA_PORT, serving
from ecosystem.waits import wait_until
from ophyd_async.core import FlyMotorInfo
from ophyd_async.epics.motor import Motor, MotorLimitsError

from integrations.epics.server import ServerSettings
from tutti.testing import LiveTestbed

both_protocols = pytest.mark.parametrize("protocol", ["pva", "ca"])


@pytest.fixture(scope="module")
def server(demo_fleet: LiveTestbed) -> Iterator[LiveTestbed]:
    with serving(demo_fleet.endpoint, ServerSettings(pva_port=PVA_PORT, ca_port=CA_PORT)):
        yield demo_fleet


@pytest.fixture(scope="module")
def engine() -> Iterator[RunEngine]:
    run_engine = RunEngine({}, context_managers=[])
    yield run_engine
    loop = run_engine.loop
    loop.call_soon_threadsafe(purge_channel_caches)
    loop.call_soon_threadsafe(loop.stop)
    run_engine._th.join(10)
    loop.close()


def motors(engine: RunEngine, protocol: str, *axes: str) -> list[Motor]:
    devices = [Motor(f"{protocol}://demo:{axis.replace('.', ':')}", name=axis.replace(".", "_")) for axis in axes]
    for device in devices:
        asyncio.run_coroutine_threadsafe(device.connect(timeout=20), engine.loop).result(30)
    return devices


def run(engine: RunEngine, plan: Any) -> list[dict[str, float]]:
    """Run a plan; return the data of its events."""
    events: list[dict[str, float]] = []
    engine(plan, lambda name, doc: events.append(doc["data"]) if name == "event" else None)
    return events


@both_protocols
def test_a_motor_moves_and_is_scanned(server: LiveTestbed, engine: RunEngine, protocol: str) -> None:
    (x,) = motors(engine, protocol, "gantry.x")
    run(engine, bps.mv(x, 12.5))
    assert server.tutti.position("gantry.x") == pytest.approx(12.5, abs=0.002)
    events = run(engine, bp.scan([], x, 10, 14, 3))
    assert [event["gantry_x"] for event in events] == pytest.approx([10, 12, 14], abs=0.002)


@pytest.mark.nightly
@both_protocols
def test_motors_of_one_controller_and_of_two_move(server: LiveTestbed, engine: RunEngine, protocol: str) -> None:
    x, y, u = motors(engine, protocol, "gantry.x", "gantry.y", "stage.u")
    run(engine, bps.mv(x, 20, y, 10, u, 1))
    axes = server.tutti.axes()
    places = [axes[name].position for name in ("gantry.x", "gantry.y", "stage.u")]
    assert places == pytest.approx([20, 10, 1], abs=0.002)
    events = run(engine, bp.grid_scan([], y, 10, 11, 2, x, 20, 22, 3, snake_axes=True))
    assert [event["gantry_x"] for event in events] == pytest.approx([20, 21, 22, 22, 21, 20], abs=0.002)


@pytest.mark.nightly
def test_two_axes_of_one_controller_move_as_one_job(server: LiveTestbed, engine: RunEngine) -> None:
    x, y = motors(engine, "pva", "gantry.x", "gantry.y")
    run(engine, bps.mv(x, 20, y, 10))
    run(engine, bps.mv(x, 30, y, 20))
    assert "gantry.x, gantry.y" in server.tutti.list_jobs(1)[0].name


@pytest.mark.nightly
@both_protocols
def test_a_motor_flies(server: LiveTestbed, engine: RunEngine, protocol: str) -> None:
    (x,) = motors(engine, protocol, "gantry.x")

    def fly() -> Any:
        yield from bps.open_run()
        yield from bps.prepare(x, FlyMotorInfo(start_position=60, end_position=100, time_for_move=1), wait=True)
        yield from bps.kickoff(x, wait=True)
        yield from bps.complete(x, wait=True)
        yield from bps.close_run()

    run(engine, fly())
    assert server.tutti.position("gantry.x") > 100
    run(engine, bps.abs_set(x.velocity, 40, wait=True))


@pytest.mark.nightly
@both_protocols
def test_a_position_beyond_the_limits_is_refused(server: LiveTestbed, engine: RunEngine, protocol: str) -> None:
    (x,) = motors(engine, protocol, "gantry.x")
    before = server.tutti.position("gantry.x")
    with pytest.raises(FailedStatus) as failed:
        run(engine, bps.mv(x, 1e4))
    assert isinstance(failed.value.__cause__, MotorLimitsError)
    assert server.tutti.position("gantry.x") == pytest.approx(before, abs=0.001)


@pytest.mark.nightly
@both_protocols
def test_an_aborted_plan_stops_the_axis(server: LiveTestbed, engine: RunEngine, protocol: str) -> None:
    (x,) = motors(engine, protocol, "gantry.x")
    run(engine, bps.mv(x, 20))
    errors: list[BaseException] = []

    def drive() -> None:
        try:
            run(engine, bps.mv(x, 390))
        except BaseException as error:
            errors.append(error)

    driving = threading.Thread(target=drive)
    driving.start()
    wait_until(lambda: server.tutti.position("gantry.x") > 30)
    engine.abort()
    driving.join(20)
    assert errors and not driving.is_alive()
    wait_until(lambda: not server.tutti.axes()["gantry.x"].moving)
    assert server.tutti.position("gantry.x") < 380
    run(engine, bps.mv(x, 20))


@pytest.mark.nightly
@both_protocols
def test_a_paused_scan_goes_on(server: LiveTestbed, engine: RunEngine, protocol: str) -> None:
    (x,) = motors(engine, protocol, "gantry.x")
    run(engine, bps.mv(x, 20))
    events: list[float] = []

    def note(name: str, doc: Any) -> None:
        if name == "event":
            events.append(doc["data"]["gantry_x"])

    def pause() -> None:
        wait_until(lambda: bool(events) and server.tutti.position("gantry.x") > 30)
        engine.request_pause()

    pausing = threading.Thread(target=pause)
    pausing.start()
    with pytest.raises(RunEngineInterrupted):
        engine(bp.scan([], x, 20, 120, 3), note)
    pausing.join(10)
    wait_until(lambda: not server.tutti.axes()["gantry.x"].moving)
    assert server.tutti.position("gantry.x") < 70
    engine.resume()
    assert events == pytest.approx([20, 70, 120], abs=0.002)
