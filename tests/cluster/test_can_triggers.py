"""Outputs of CiA 402 drives that are switched in the stream of their positions, against the true edges."""

import asyncio
from typing import Any

import pytest
from cluster.test_triggers import TrueEdges, check_rows, moved, run_job
from cluster.worlds import job, run_fleet

from orchestrator.client.api import Tutti
from orchestrator.client.steps import JobFailed
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

LIMITS = {"velocity": 100, "acceleration": 500, "jerk": 10_000}
PERIOD_NS = 10 * NS_PER_MS
X = "output: c0.lamp"


def fleet(*more: str) -> Fleet:
    """Two drives on one bus, and `more` without a limit of jerk; each with outputs."""
    controllers: dict[str, Any] = {}
    for number, name in enumerate(("c0", "c1", *more)):
        limits = LIMITS if name not in more else {"velocity": 100, "acceleration": 500}
        controllers[name] = {
            "adapter": "cia402",
            "link": {"kind": "can", "interface": "socketcan", "channel": "can0", "address": number + 1},
            "options": {"cycle_us": 100, "start_us": 50, "start_spread_us": 50, "output_us": 100},
            "axes": {"x": {"motors": ["1"], "unit": "mm", "scale": 1000, "limits": limits}},
            "outputs": {"lamp": {"number": 1}, "other": {"number": 2}},
            "simulate": {"drift_ppm": 40 - 80 * number},
        }
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "streams", "controllers": controllers})


async def run_drives(virtual: VirtualFleet) -> Tutti:
    """A client, once all axes are homed."""
    client = virtual.make_client("operator")
    await client.run(job(f"[{{do: enable, axes: [{', '.join(virtual.fleet.controllers)}]}}, {{do: home}}]"))
    return client


def true_edges(virtual: VirtualFleet, name: str, number: int = 1) -> TrueEdges:
    return TrueEdges(virtual, name, ((f"{name}.x", name, "1"),), number)


def test_pulses_and_levels_come_with_the_syncs_next_to_their_instants() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = await run_drives(virtual)
        near, level, far = true_edges(virtual, "c0"), true_edges(virtual, "c0", 2), true_edges(virtual, "c1")
        asked = (
            f"{{{X}, every: 5 mm, of: c0.x, pulse: 10 ms}}, {{output: c0.other, every: 100 ms, level: true}}, "
            "{output: c1.lamp, every: 2 mm, of: c1.x, pulse: 15 ms}"
        )
        report, rows = await run_job(client, moved(asked, "c0.x: 60, c1.x: -20", "speed: 0.7,"))
        (step,) = report.steps
        assert report.state == "done" and not step.deviations, (report.reason, step.deviations)
        assert [each.output for each in step.triggers] == ["c0.lamp", "c0.other", "c1.lamp"]
        check_rows(rows[:12], near.rises())
        check_rows(rows[-10:], far.rises())
        # A level is passive after the end, without a row for that.
        check_rows(rows[12:-10], [at_ns for at_ns, _ in level.edges[: len(rows) - 22]])
        assert not level.edges[-1][1] and len(level.edges) == len(rows) - 22 + len(rows) % 2
        for true, periods in ((near, 1), (far, 2)):
            for (on_ns, on), (off_ns, off) in zip(true.edges[::2], true.edges[1::2], strict=True):
                assert on and not off and abs(off_ns - on_ns - periods * PERIOD_NS) < 0.3 * NS_PER_MS
        for row in rows:
            assert row.seen is not None and row.seen.latest_ns - row.seen.earliest_ns < 1.5 * NS_PER_MS
            # The nearest of all SYNCs, and what the bus and the drive take for it.
            assert row.latest_ns - row.earliest_ns < PERIOD_NS + 2 * NS_PER_MS

    run_fleet(main, fleet())


def test_pulses_along_a_path_of_two_drives() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = await run_drives(virtual)
        true = true_edges(virtual, "c0")
        path = "do: path, axes: [c0.x, c1.x], start: [0, 0], tolerance: 0.5, speed: 50 mm/s"
        pieces = "[{piece: arc, to: [0, 0], centre: [20, 0]}]"
        trigger = f"{{{X}, every: 4 mm, of: c0.x, pulse: 10 ms}}"
        report, rows = await run_job(client, job(f"[{{{path}, pieces: {pieces}, triggers: [{trigger}]}}]"))
        (step,) = report.steps
        # It passes each position twice.
        assert report.state == "done" and not step.deviations and len(rows) == 20, (report.reason, step.deviations)
        check_rows(rows, true.rises())
        for row, place in zip(rows, true.places[::2], strict=True):
            assert row.positions["c0.x"].least <= place["c0.x"] <= row.positions["c0.x"].most

    run_fleet(main, fleet())


LONG = moved(
    f"{{{X}, every: 40 ms, pulse: 20 ms}}, {{output: c1.lamp, every: 40 ms, pulse: 20 ms}}",
    "c0.x: 100, c1.x: 100",
    "speed: 0.5,",
)


@pytest.mark.parametrize("way", ["estop", "limit", "link", "host"])
def test_no_output_is_active_after_an_end_of_any_kind(way: str) -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = await run_drives(virtual)
        both = true_edges(virtual, "c0"), true_edges(virtual, "c1")
        running = asyncio.ensure_future(run_job(client, LONG))
        while len(both[0].rises()) < 8:
            await sleep_ns(virtual.clock, NS_PER_MS)
        if way == "estop":
            await client.estop("test")
        elif way == "link":
            virtual.wires["c0"].cut = virtual.wires["c0"].refuse = True
        elif way == "host":
            virtual.freeze("host/" + virtual.fleet.controllers["c0"].host)
        else:
            virtual.act_on_controller("c0", lambda unit: unit.set_limit("1", "forward"))
        await sleep_ns(virtual.clock, (2000 if way in ("link", "host") else 200) * NS_PER_MS)
        if way == "link":
            # Without its computer a drive keeps its outputs; they are passive as soon as it is connected again.
            virtual.wires["c0"].cut = virtual.wires["c0"].refuse = False
            await sleep_ns(virtual.clock, 2 * NS_PER_S)
        counts = [len(each.edges) for each in both]
        assert not any(each.edges[-1][1] for each in both), way
        await sleep_ns(virtual.clock, NS_PER_S)
        assert [len(each.edges) for each in both] == counts
        if way == "limit":
            report, rows = await running
            assert report.state == "failed"
            for true, half in zip(both, (rows[: len(rows) // 2], rows[len(rows) // 2 :]), strict=True):
                seen = [row for row in half if row.seen is not None]
                # What is claimed has happened; of at most one edge nothing is known.
                assert len(true.rises()) - 1 <= len(seen) <= len(true.rises())
                check_rows(seen, true.rises()[: len(seen)])
        running.cancel()

    run_fleet(main, fleet())


REFUSED = (
    ("output: c0.lamp, every: 50 ms", "c0.x: 20", "trigger-pulse", "write `pulse: 10 ms`"),
    ("output: c0.lamp, every: 15 ms, pulse: 10 ms", "c0.x: 20", "trigger-rate", "write at least 20 ms"),
    ("output: c0.lamp, every: 0.1 mm, of: c0.x, pulse: 15 ms", "c0.x: 20", "trigger-rate", "at least 30 ms"),
    ("output: c0.lamp, every: 12 ms, level: true", "c0.x: 20", "trigger-rate", "at least 20 ms"),
    ("output: c1.lamp, every: 50 ms, pulse: 10 ms", "c0.x: 20", "trigger-axis", "move x in the step, too"),
    ("output: c2.lamp, every: 50 ms, pulse: 10 ms", "c2.x: 20, c0.x: 20", "trigger-axis", "add a `jerk` limit"),
)


def test_what_the_stream_cannot_give_is_refused() -> None:
    async def main(virtual: VirtualFleet) -> None:
        client = await run_drives(virtual)
        true = [true_edges(virtual, name) for name in ("c0", "c1", "c2")]
        for trigger, to, code, words in REFUSED:
            await client.start_queue()
            with pytest.raises(JobFailed) as failed:
                await client.run(moved(f"{{{trigger}}}", to))
            refused = failed.value.report.steps[-1].refused
            assert refused is not None and refused.code == code, refused
            assert words in f"{refused.text} {refused.remedy}", refused
        assert not any(each.edges for each in true)

    run_fleet(main, fleet("c2"))
