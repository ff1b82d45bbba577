"""Two CiA 402 drives on one bus as a user runs them: adapter, link, slcan, simulators, guardian; judged by the
simulators' ground truth."""

import sys
import time
from collections.abc import Iterator
from pathlib import Path

import can
import pytest
from children import wait_until
from fleet import RunningFleet, margin_s

pytestmark = pytest.mark.live

FLEET = """
schema: tutti.fleet/1
fleet: demo
controllers:
  left:
    adapter: cia402
    link: {kind: can, interface: slcan, channel: /dev/ttyACM0, address: 3}
    options: &patient {answer_ms: 1000, heartbeat_ms: 500}  # of a machine that does other things besides
    axes: {a: &axis {motors: ["1"], unit: mm, scale: 1000, limits: {velocity: 80, acceleration: 400}, homing: {method: "37"}}}
    inputs: {lit: {number: 1}}
    simulate: {decode_us: 300, drift_ppm: 20}
  right:
    adapter: cia402
    link: {kind: can, interface: slcan, channel: /dev/ttyACM0, address: 4}
    options: *patient
    axes: {b: *axis}
    outputs: {lamp: {number: 2}}
    simulate: {decode_us: 300, drift_ppm: -30}
wiring:
  - {from: right.lamp, to: [left.lit]}
"""
READY = [{"do": "enable", "axes": ["left", "right"]}, {"do": "home"}]

# The time in which the guardian notices, opens the bus in a process of its own, and stops; a busy machine included.
STOPPED_S = 4.0


def note(name: str, value: object) -> None:
    """Shown by `pytest -rP`."""
    sys.stdout.write(f"{name}: {value}\n")


@pytest.fixture
def fleet(tmp_path: Path) -> Iterator[RunningFleet]:
    file = tmp_path / "can.fleet.yaml"
    file.write_text(FLEET)
    fleet = RunningFleet(tmp_path, file)
    try:
        yield fleet.started()
    finally:
        fleet.close()


def test_one_job_moves_both_drives_and_the_report_covers_both(fleet: RunningFleet) -> None:
    report = fleet.run([*READY, {"do": "move", "to": {"left.a": 30, "right.b": -20}}])
    assert report.state == "done", report.reason
    step = report.steps[-1]
    starts = [
        entry["start_ns"] for name in ("left", "right") for entry in fleet.truth(name) if entry["event"] == "start"
    ]
    ends = {name: fleet.at_rest(name)["end_counts"] for name in ("left", "right")}
    assert ends == {"left": 30_000.0, "right": -20_000.0}
    assert len(starts) == 2
    assert step.start_skew is not None
    assert step.start_skew.at_least_ns <= abs(starts[0] - starts[1]) <= step.start_skew.at_most_ns
    lit = fleet.run([{"do": "output", "output": "right.lamp", "value": True}])
    assert lit.state == "done", lit.reason
    wait_until(lambda: fleet.status()["left"].inputs["lit"], "the wire between the drives")
    file = fleet.folder / "bus.blf"
    traced = fleet.tutti("trace", "left", "--format", "blf", "--output", str(file))
    assert traced.returncode == 0, traced.stdout + traced.stderr
    with can.LogReader(file) as log:
        syncs = [each for each in log if each.arbitration_id == 0x080]
    assert syncs
    assert abs(syncs[-1].timestamp - time.time()) < 60
    alone = fleet.tutti("trace", "left", "--format", "blf")
    assert (alone.returncode, "--output" in alone.stderr) == (2, True)


@pytest.mark.nightly
def test_the_guardian_stops_a_bus_whose_adapter_host_is_killed(fleet: RunningFleet) -> None:
    report = fleet.run(READY)
    assert report.state == "done", report.reason
    fleet.submit([{"do": "move", "to": {"left.a": 400, "right.b": 400}, "speed": 0.1}])
    wait_until(lambda: fleet.starts("left") + fleet.starts("right") == 2, "both move")
    killed_ns = fleet.kill("adapters.host.host_process")
    for name in ("left", "right"):
        last = fleet.at_rest(name)
        note(f"{name} at rest after s", margin_s(killed_ns, last["end_ns"]))
        assert 0 <= margin_s(killed_ns, last["end_ns"]) < STOPPED_S
        assert last["end_counts"] < 100_000
    fleet.works()
