"""Clients of EPICS drive the demo fleet: ophyd-async's `Motor`, p4p and caproto, none of them changed."""

from collections.abc import Callable, Generator, Iterator
from typing import Any

import bluesky.plan_stubs as bps
import bluesky.plans as bp
import pytest
from aioca import purge_channel_caches
from bluesky import RunEngine
from ecosystem.epics_server import free_ports, serving, set_client_environment
from ophyd_async.core import init_devices
from ophyd_async.epics.motor import Motor

from integrations.epics.server import ServerSettings
from tutti.testing import LiveTestbed

PVA_PORT, CA_PORT = free_ports(2)
set_client_environment(PVA_PORT, CA_PORT)


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


@pytest.mark.parametrize("protocol", ["pva", "ca"])
def test_a_motor_moves(server: LiveTestbed, engine: RunEngine, protocol: str) -> None:
    with init_devices(timeout=10):
        x = Motor(f"{protocol}://demo:gantry:x", name="x")
    engine(bps.mv(x, 12.5))
    assert server.tutti.position("gantry.x") == pytest.approx(12.5, abs=0.002)
    events: list[Any] = []
    engine(bp.scan([], x, 10, 14, 3), lambda name, doc: events.append(doc["data"]) if name == "event" else None)
    assert [e["x"] for e in events] == pytest.approx([10, 12, 14], abs=0.002)
