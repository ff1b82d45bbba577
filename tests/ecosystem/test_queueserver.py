"""The RunEngine manager of bluesky-queueserver, with devices that it makes from the fleet file, moves the demo fleet."""

import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from bluesky_queueserver_api.zmq import REManagerAPI
from ecosystem.programs import require_program
from ecosystem.waits import wait_until

from orchestrator.runtime.live.fleet import find_free_port
from tutti.testing import LiveTestbed, find_example

STARTUP = """
from bluesky import RunEngine
from bluesky.plans import scan
from ophyd_async.core import init_devices
from integrations.bluesky import TuttiConnection, make_devices

RE = RunEngine({{}})
with init_devices():
    globals().update(make_devices({fleet!r}, TuttiConnection({endpoint!r})))
"""

RIGHTS = """
user_groups:
  root:
    allowed_plans: [null]
    forbidden_plans: [null]
    allowed_devices: [null]
    forbidden_devices: [null]
    allowed_functions: [null]
    forbidden_functions: [null]
  primary:
    allowed_plans: [":.*"]
    forbidden_plans: [":^_"]
    allowed_devices: [":?.*:depth=5"]
    forbidden_devices: [":^_:?.*"]
    allowed_functions: []
    forbidden_functions: []
"""


@pytest.fixture
def store(tmp_path: Path) -> Iterator[str]:
    """The address of a store of queues of this test."""
    program = require_program("redis-server")
    port = find_free_port()
    words = [program, "--port", str(port), "--bind", "127.0.0.1", "--save", "", "--dir", str(tmp_path)]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL) as process:
        yield f"127.0.0.1:{port}"
        process.terminate()


@pytest.fixture
def manager(demo_fleet: LiveTestbed, store: str, tmp_path: Path) -> Iterator[REManagerAPI]:
    """A running manager of this test, with an open environment."""
    script = tmp_path / "startup.py"
    script.write_text(STARTUP.format(fleet=str(find_example("demo.fleet.yaml")), endpoint=demo_fleet.endpoint))
    control, info = (f"tcp://127.0.0.1:{find_free_port()}" for _ in range(2))
    command = Path(sys.executable).with_name("start-re-manager")
    words = [str(command), "--redis-addr", store, "--zmq-control-addr", control, "--zmq-info-addr", info]
    words += ["--startup-script", str(script), "--user-group-permissions", str(tmp_path / "rights.yaml")]
    words += ["--existing-plans-devices", str(tmp_path / "existing.yaml")]
    (tmp_path / "rights.yaml").write_text(RIGHTS)
    log = tmp_path / "manager.txt"
    with log.open("wb") as output, subprocess.Popen(words, stdout=output, stderr=output) as process:
        api = REManagerAPI(zmq_control_addr=control, zmq_info_addr=info, request_fail_exceptions=True)
        wait_until(lambda: is_up(api))
        api.environment_open()
        wait_for(api, lambda status: status["worker_environment_exists"], log)
        yield api
        api.environment_destroy()
        wait_for(api, lambda status: not status["worker_environment_exists"], log)
        api.close()
        process.terminate()


def is_up(api: REManagerAPI) -> bool:
    try:
        api.ping()
    except api.RequestTimeoutError:
        return False
    return True


def wait_for(api: REManagerAPI, condition: Callable[[dict[str, Any]], bool], log: Path) -> None:
    """Wait for a status; a failure shows what the manager wrote."""
    try:
        wait_until(lambda: condition(api.status(reload=True)))
    except AssertionError:
        pytest.fail(log.read_text())


@pytest.mark.nightly
def test_a_queue_moves_devices_that_no_file_lists(
    demo_fleet: LiveTestbed, manager: REManagerAPI, tmp_path: Path
) -> None:
    devices = manager.devices_existing()["devices_existing"]
    assert {"gantry_x", "gantry_y", "stage_u"} <= set(devices)
    plan = {"name": "scan", "args": [[], "gantry_x", 30, 32, "stage_u", 2, 3], "kwargs": {"num": 3}}
    manager.item_add(plan | {"item_type": "plan"}, user="operator", user_group="primary")
    manager.queue_start()
    log = tmp_path / "manager.txt"
    wait_for(manager, lambda status: status["items_in_history"] == 1 and status["manager_state"] == "idle", log)
    [item] = manager.history_get()["items"]
    assert item["result"]["exit_status"] == "completed", item["result"]["traceback"]
    axes = demo_fleet.tutti.axes()
    assert axes["gantry.x"].position == pytest.approx(32, abs=0.002)
    assert axes["stage.u"].position == pytest.approx(3, abs=0.002)
