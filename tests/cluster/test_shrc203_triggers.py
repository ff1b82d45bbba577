"""The trigger output of an SHRC-203, against its true pulses: a pulse every whole number of drive pulses of an axis."""

import asyncio
from typing import Any

import pytest
from cluster.test_triggers import TrueEdges, check_rows, moved, run_job, run_prepared
from cluster.worlds import changed, demo_fleet, job, run_fleet

from orchestrator.client.api import Tutti
from orchestrator.client.steps import JobFailed
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.shrc203.controller import Shrc203Controller

CAMERA = "output: stage.camera, of: stage.u, pulse: 10 us"
LONG = moved(f"{{{CAMERA}, every: 0.1 mm}}", to="stage.u: 40", more="speed: 0.2,")


def with_camera(**more: Any) -> Fleet:
    outputs = {"camera": {"number": 7}, "shutter": {"number": 1}}
    return changed(demo_fleet(), stage={"outputs": outputs, **more})


async def run_stage(virtual: VirtualFleet, wait_s: float = 0.0) -> tuple[Tutti, TrueEdges]:
    """A client, once all axes are homed, and the true pulses from then on."""
    true = TrueEdges(virtual, "stage", (("stage.u", "stage", "1"),))
    client = await run_prepared(virtual, wait_s)
    true.forget()
    return client, true


def trigger_setting(virtual: VirtualFleet) -> str:
    """What the trigger output is set to, as `?:T` states it."""
    stage = virtual.controllers["stage"]
    assert isinstance(stage, Shrc203Controller)
    return str(stage.unit.trigger.setting or "NS")


def test_pulses_are_where_promised_and_where_the_evidence_says() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client, true = await run_stage(virtual, 5)
        for to, places, speed, count in (
            (4, "every: 0.2 mm", 0.2, 20),
            (0, "every: 0.06 mm", 0.1, 66),  # back, and the end is not one of them
            (10, "at: [2, 4, 6, 8, 10]", 0.3, 5),
        ):
            asked = moved(f"{{{CAMERA}, {places}}}", to=f"stage.u: {to}, gantry.x: {to}", more=f"speed: {speed},")
            report, rows = await run_job(client, asked)
            (step,) = report.steps
            assert report.state == "done" and not step.deviations, (report.reason, step.deviations)
            assert len(rows) == count and trigger_setting(virtual) == "NS"
            check_rows(rows, true.rises())
            # Each lasts ten microseconds, and the axis truly was where its row says.
            pulses = zip(true.edges[::2], true.edges[1::2], strict=True)
            assert all(abs(off - on - 10_000) < 10 for (on, _), (off, _) in pulses)
            for row, place in zip(rows, true.places[::2], strict=True):
                u = row.positions["stage.u"]
                assert u.least <= place["stage.u"] <= u.most and u.most - u.least < 0.03
            assert max(row.seen.latest_ns - row.seen.earliest_ns for row in rows if row.seen) < 5 * NS_PER_MS
            true.forget()

    run_fleet(main, with_camera())


@pytest.mark.parametrize("way", ["armed", "stop", "estop", "limit", "link", "coordinator"])
def test_no_pulse_is_left_after_an_end_of_any_kind(way: str) -> None:
    async def main(virtual: VirtualFleet) -> None:
        client, true = await run_stage(virtual)
        running = asyncio.ensure_future(run_job(client, LONG))
        while trigger_setting(virtual) == "NS" if way == "armed" else len(true.rises()) < 20:
            await sleep_ns(virtual.clock, NS_PER_MS)
        await _break_off(virtual, client, way)
        # It has no watchdog: without its adapter it goes on to its target, as ever.
        while virtual.controllers["stage"].is_moving("1"):
            await sleep_ns(virtual.clock, 10 * NS_PER_MS)
        count = len(true.rises())
        assert (count == 400) == (way == "link") and bool(count) == (way != "armed")
        await sleep_ns(virtual.clock, 3000 * NS_PER_MS)
        assert len(true.rises()) == count
        if way == "limit":
            report, rows = await running
            seen = [row for row in rows if row.seen is not None]
            assert report.state != "done" and len(true.rises()) - 1 <= len(seen) <= len(true.rises())
            for row, at_ns in zip(seen, true.rises(), strict=False):
                assert row.seen is not None and row.seen.earliest_ns <= at_ns <= row.seen.latest_ns
                # Polls have seen the axis on both sides of it.
                assert row.seen.latest_ns - row.seen.earliest_ns < 250 * NS_PER_MS
        else:
            running.cancel()
        if way == "coordinator":
            return
        # Whatever moves the axis next gives no pulse.
        true.forget()
        if way == "link":
            wire = virtual.wires["stage"]
            wire.cut = wire.refuse = False
            await sleep_ns(virtual.clock, 2000 * NS_PER_MS)
        if way == "limit":
            virtual.act_on_controller("stage", lambda unit: unit.set_limit("1", "none"))
        if way in ("estop", "limit"):
            await client.reset()
        await client.start_queue()
        await client.run(
            job("[{do: enable, axes: [stage]}, {do: home, axes: [stage.u]}, {do: move, to: {stage.u: 1}}]")
        )
        assert not true.edges

    run_fleet(main, with_camera())


async def _break_off(virtual: VirtualFleet, client: Tutti, way: str) -> None:
    if way in ("armed", "stop"):
        await client.stop()
    elif way == "estop":
        await client.estop("test")
    elif way == "limit":
        virtual.act_on_controller("stage", lambda unit: unit.set_limit("1", "forward"))
    elif way == "link":
        wire = virtual.wires["stage"]
        wire.cut = wire.refuse = True
    else:
        virtual.kill("coordinator/first")


REFUSED = (
    ("every: 0.1 mm, of: stage.u", "trigger-pulse", "write `pulse: 10 us`"),
    ("every: 0.1 mm, of: stage.u, level: true", "trigger-pulse", "a level asked for"),
    ("every: 10 ms, pulse: 10 us", "trigger-time", "at positions of its own axes only"),
    ("every: 1 mm, of: gantry.x, pulse: 10 us", "trigger-time", "an axis of this controller"),
    ("every: 1 um, of: stage.v, pulse: 10 us", "trigger-axis", "does not move"),
    ("at: [1, 2, 3.5], of: stage.u, pulse: 10 us", "trigger-positions", "not equally far apart"),
    ("at: [1, 2], of: stage.u, pulse: 10 us", "trigger-positions", "go on behind the last"),
    ("every: 0.33333 mm, of: stage.u, pulse: 10 us", "trigger-positions", "0.3333 mm` or `every: 0.3334 mm`"),
    ("every: 3.5 mm, of: stage.u, pulse: 10 us", "trigger-positions", "every: 3 mm"),
    ("every: 0.1 mm, of: stage.u, pulse: 10 us", "trigger-speed", "5.6 mm/s at most"),
)


def test_what_the_trigger_output_cannot_give_is_refused() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client, true = await run_stage(virtual)
        for trigger, code, words in REFUSED:
            speed = 0.8 if code == "trigger-speed" else 0.2
            asked = moved(
                f"{{output: stage.camera, {trigger}}}", "stage.u: 4, stage.v: 0, gantry.x: 3", f"speed: {speed},"
            )
            await client.start_queue()
            with pytest.raises(JobFailed) as failed:
                await client.run(asked)
            refused = failed.value.report.steps[-1].refused
            assert refused is not None and refused.code == code, refused
            assert words in f"{refused.text} {refused.remedy}", refused
        assert not true.edges and trigger_setting(virtual) == "NS"

    run_fleet(main, with_camera())
