"""Scripts of users against a running fleet: an interrupted one stops what it has begun, and says so."""

import asyncio
import signal
import subprocess
import sys
from pathlib import Path

import pytest
from children import LIMIT_S, wait_until
from fleet import RunningFleet, run_example

from tutti import BlockingTutti, Dwell, Job, Tutti

pytestmark = pytest.mark.live

BLOCKING = """
from tutti import BlockingTutti
with BlockingTutti("{endpoint}") as tutti:
    print(f"{{tutti.position('gantry.x'):.2f}}", flush=True)
    tutti.move({{"gantry.x": 200, "stage.u": 20}}, speed=0.05)
"""
ASYNC = """
import asyncio
from tutti import Tutti
async def main():
    async with Tutti("{endpoint}") as tutti:
        await tutti.move({{"gantry.x": 200, "stage.u": 20}}, speed=0.05)
asyncio.run(main())
"""


@pytest.mark.parametrize("script", [BLOCKING, ASYNC], ids=["blocking", "async"])
def test_an_interrupted_script_stops_its_axes_and_says_so(shared: RunningFleet, script: str) -> None:
    shared.bring_back()
    code = script.format(endpoint=shared.endpoint)
    process = subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    try:
        wait_until(lambda: all(each.mode == "moving" for each in shared.status().values()), "the axes move")
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=LIMIT_S)
    finally:
        process.kill()
    assert "tutti: interrupted: move is cancelled" in err
    assert all(each.mode == "idle" for each in shared.status().values())
    assert shared.status()["gantry"].axes["x"].position < 190


def test_the_examples_say_what_is_wrong_with_their_input(shared: RunningFleet, tmp_path: Path) -> None:
    bad = tmp_path / "bad.job.yaml"
    bad.write_text("schema: tutti.job/1\nname: bad\nsteps: [{do: move, to: {gantry.q: 1}}]\n")
    for words, text in (
        (["submit_job.py", str(bad), shared.endpoint], "gantry.q"),
        (["submit_job.py", str(tmp_path / "none.yaml"), shared.endpoint], "cannot be read"),
        (["jog_by_hand.py", "gantry.q", "1", shared.endpoint], "gantry.q"),
    ):
        done = run_example(*words)
        assert done.returncode == 1 and text in done.stderr and "Traceback" not in done.stderr


def test_a_notebook_moves_axes_although_its_own_loop_runs(shared: RunningFleet) -> None:
    """A cell of a notebook runs inside an event loop."""
    shared.bring_back()

    async def cell() -> float:
        with BlockingTutti(shared.endpoint) as tutti:
            tutti.move({"gantry.x": 3})
            seen = [now["gantry.x"] for now, _ in zip(tutti.positions(["gantry.x"], hz=50), range(3), strict=False)]
            assert len(seen) == 3
            with pytest.raises(RuntimeError, match="callback"):
                job = tutti.submit(Job("one", [Dwell(duration="2 s")]))
                tutti.wait_for_job(job.id, lambda _: tutti.stop_queue())
            return tutti.position("gantry.x")

    assert asyncio.run(cell()) == pytest.approx(3, abs=0.01)


def test_a_connection_belongs_to_the_event_loop_that_opened_it(shared: RunningFleet) -> None:
    tutti = Tutti(shared.endpoint)
    first = asyncio.new_event_loop()
    try:
        first.run_until_complete(tutti.open())
        with pytest.raises(RuntimeError, match="another event loop"):
            asyncio.run(tutti.status())
        assert len(first.run_until_complete(tutti.status())) == 2
    finally:
        first.run_until_complete(tutti.close())
        first.close()
