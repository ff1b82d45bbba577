"""A move that gets other targets while it moves, or is being started."""

import asyncio
import random
from collections.abc import Generator
from contextlib import contextmanager
from itertools import pairwise
from typing import Any

import pytest
from cluster.test_can_streams import fleet as streams_and_contour
from cluster.worlds import PREPARE, demo_fleet, job, line_fleet, outcome, run_fleet

from orchestrator.client import SubmittedJob, Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.report import JobReport, StepRetarget
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.cia402.unit import SimulatedDrive

FAR = "[{do: move, to: {gantry.x: 300, gantry.y: 60, stage.u: 20}, speed: 0.3}]"
OTHER = {"gantry.x": 40, "gantry.y": 80, "stage.u": 5}
SAMPLE_NS = 5 * NS_PER_MS
MAKES = ("gantry", "outlet", "stage", "lift", "tilt", "arm")
START_RATES = ("lift.z", "tilt.z")  # steppers, which start and stop at a speed


@contextmanager
def raises_refusal(code: str) -> Generator[None]:
    with pytest.raises(Refusal) as caught:
        yield
    assert caught.value.code == code, caught.value


async def wait_for_state(fleet: VirtualFleet, submitted: SubmittedJob, state: str) -> None:
    while (await submitted.show()).transitions[-1].state != state:
        await sleep_ns(fleet.clock, 2 * NS_PER_MS)


async def begin(fleet: VirtualFleet, steps: str, after_s: float = 1.0) -> tuple[Tutti, SubmittedJob]:
    """A job whose first step has moved for `after_s`."""
    client = fleet.make_client()
    submitted = await client.submit(job(steps))
    await wait_for_state(fleet, submitted, "running")
    await sleep_ns(fleet.clock, round(after_s * NS_PER_S))
    return client, submitted


def position(fleet: VirtualFleet, name: str) -> float:
    """The true position of an axis, in its unit."""
    axis = fleet.fleet.axis(name)
    return fleet.controllers[name.partition(".")[0]].position(axis.motors[0]) / float(axis.scale)


class LimitWatch:
    """Samples the true velocities of axes, and compares them and their changes with the limits."""

    def __init__(self, fleet: VirtualFleet, names: list[str]) -> None:
        self._fleet = fleet
        self._axes = {name: fleet.fleet.axis(name) for name in names}
        self._task = asyncio.get_running_loop().create_task(self._run())
        self.problems: list[str] = []
        self.fastest = dict.fromkeys(names, 0.0)

    async def _run(self) -> None:
        before: dict[str, float] = {}
        while True:
            for name, axis in self._axes.items():
                unit = self._fleet.controllers[name.partition(".")[0]]
                velocity = unit.velocity(axis.motors[0]) / float(axis.scale)
                change = abs(velocity - before.get(name, velocity)) / (SAMPLE_NS / NS_PER_S)
                before[name] = velocity
                self.fastest[name] = max(self.fastest[name], abs(velocity))
                if abs(velocity) > axis.limits.velocity * 1.001:
                    self.problems.append(f"{name}: velocity {velocity}")
                if change > axis.limits.acceleration * 1.02 and name not in START_RATES:
                    self.problems.append(f"{name}: acceleration {change}")
            await sleep_ns(self._fleet.clock, SAMPLE_NS)

    def close(self) -> None:
        self._task.cancel()


@pytest.mark.parametrize("after_s", [0.2, 1.0, 4.0])
def test_axes_of_two_makes_brake_together_and_go_on_to_other_targets_as_one_step(after_s: float) -> None:
    async def main(fleet: VirtualFleet) -> JobReport:
        await outcome(fleet, PREPARE)
        _, submitted = await begin(fleet, FAR, after_s)
        watch = LimitWatch(fleet, list(OTHER))
        reply = await submitted.retarget(OTHER)
        assert (reply.outcome, reply.way) == ("changed", "brake") and reply.within_s > 0
        report = await submitted.result()
        watch.close()
        assert report.state == "done", report.reason
        assert {name: position(fleet, name) for name in OTHER} == pytest.approx(OTHER, abs=1e-3)
        assert not watch.problems, watch.problems[:5]
        return report

    (step,) = run_fleet(main).steps
    (entry,) = step.retargets
    assert (entry.number, entry.by, entry.way, entry.replaced) == (1, "client", "brake", 0)
    assert entry.before == {"gantry.x": 300, "gantry.y": 60, "stage.u": 20} and entry.to == OTHER
    assert entry.changed_ns is not None and entry.started_ns is not None
    assert 0 < entry.changed_ns < entry.started_ns
    assert step.feed_holds == [] and step.verdict == "green"
    assert set(step.positions) == set(OTHER)


@pytest.mark.parametrize("name", MAKES)
def test_each_make_goes_to_its_other_target(name: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        controller = fleet.fleet.controllers[name]
        axis = f"{name}.{next(iter(controller.axes))}"
        prepare = job(f"[{{do: enable, axes: [{name}]}}, {{do: home, axes: [{axis}]}}]")
        assert (await outcome(fleet, prepare)).state == "done"
        here, speed = position(fleet, axis), fleet.fleet.axis(axis).limits.velocity
        watch = LimitWatch(fleet, [axis])
        _, submitted = await begin(fleet, f"[{{do: move, by: {{{axis}: {0.8 * speed}}}, speed: 0.4}}]")
        await submitted.retarget(by={axis: -0.6 * speed})
        report = await submitted.result()
        watch.close()
        assert report.state == "done", report.reason
        resolution = 1 / float(fleet.fleet.axis(axis).scale)
        assert position(fleet, axis) - here == pytest.approx(0.2 * speed, abs=1.01 * resolution)
        assert len(report.steps[0].retargets) == 1
        assert not watch.problems, watch.problems[:5]

    run_fleet(main, line_fleet(name))


@pytest.mark.parametrize("state", ["planning", "arming", "armed", "committed"])
def test_a_retarget_before_the_start_replaces_the_move(state: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        submitted = await fleet.make_client().submit(job(FAR))
        async for event in submitted.events():
            if event.state == state:
                assert (await submitted.retarget(OTHER)).outcome == "changed"
                break
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert {name: position(fleet, name) for name in OTHER} == pytest.approx(OTHER, abs=1e-3)
        (entry,) = report.steps[0].retargets
        assert entry.started_ns is not None

    run_fleet(main)


def test_of_a_thousand_in_a_second_the_newest_counts() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client, submitted = await begin(fleet, FAR)
        outcomes: list[str] = []

        async def ask(number: int) -> None:
            target = {**OTHER, "gantry.x": 40 + number / 100}
            outcomes.append((await client.retarget_job(submitted, target)).outcome)

        asking: list[asyncio.Task[None]] = []
        for number in range(1000):
            asking.append(asyncio.get_running_loop().create_task(ask(number)))
            await sleep_ns(fleet.clock, NS_PER_MS)
        await asyncio.gather(*asking)
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert position(fleet, "gantry.x") == pytest.approx(49.99, abs=1e-3)
        assert len(outcomes) == 1000 and set(outcomes) <= {"changed", "replaced"}
        entries = report.steps[0].retargets
        assert sum(1 + entry.replaced for entry in entries) == 1000
        assert entries[-1].to["gantry.x"] == 49.99

    run_fleet(main)


def test_the_present_target_changes_nothing_and_a_bad_one_neither() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        before = len(fleet.controllers["gantry"].commanded_motions)
        client, submitted = await begin(fleet, FAR)
        same = {"gantry.x": 300, "gantry.y": 60, "stage.u": 20}
        assert (await submitted.retarget(same)).outcome == "same"
        assert (await submitted.retarget(by=dict.fromkeys(same, 0))).outcome == "same"
        bad: dict[str, dict[str, Any]] = {
            "soft-limit": {"to": {**same, "gantry.x": 100_000}},
            "other-axes": {"to": {"gantry.x": 5}},
            "bad-unit": {"to": {**same, "gantry.x": "5 deg"}},
        }
        for code, targets in bad.items():
            with raises_refusal(code):
                await submitted.retarget(**targets)
        with raises_refusal("other-axes"):
            await submitted.retarget(same, by={"gantry.x": 1})
        with raises_refusal("other-axes"):
            await submitted.retarget({**same, "gantry.z": 1})
        with raises_refusal("unknown-job"):
            await client.retarget_job("nothing", same)
        report = await submitted.result()
        assert report.state == "done" and report.steps[0].retargets == []
        assert len(fleet.controllers["gantry"].commanded_motions) == before + 2  # never interrupted
        with raises_refusal("ended"):
            await submitted.retarget(same)

    run_fleet(main)


def test_what_is_no_move_has_no_other_target() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        _, waiting = await begin(fleet, "[{do: dwell, duration: 5 s}]")
        with raises_refusal("not-moving"):
            await waiting.retarget({"gantry.x": 1})
        assert (await waiting.result()).state == "done"
        _, scan = await begin(fleet, "[{do: scan, axes: {gantry.x: {from: 100, to: 200, points: 3}}, speed: 0.1}]")
        with raises_refusal("not-a-move"):
            await scan.retarget({"gantry.x": 1})
        await scan.cancel()
        _, held = await begin(fleet, FAR)
        await held.pause(now=True)
        with raises_refusal("paused"):
            await held.retarget(OTHER)
        await held.cancel()

    run_fleet(main)


def test_a_step_prepared_behind_it_begins_from_the_new_target() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        steps = f"{FAR[:-1]}, {{do: move, by: {{gantry.x: 5, stage.u: 1}}}}]"
        _, submitted = await begin(fleet, steps, 2.0)
        await submitted.retarget(OTHER)
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert position(fleet, "gantry.x") == pytest.approx(45, abs=1e-3)
        assert position(fleet, "stage.u") == pytest.approx(6, abs=1e-3)
        assert report.steps[1].chain is not None and report.steps[1].chain.kept

    run_fleet(main)


@pytest.mark.parametrize("ms", range(0, 400, 40))
def test_a_retarget_near_the_end_is_taken_or_refused(ms: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        steps = "[{do: move, to: {gantry.x: 20}, speed: 0.5}, {do: move, to: {gantry.x: 30}}]"
        client, submitted = await begin(fleet, steps, 0.15 + ms / 1000)
        try:
            reply = await client.retarget_job(submitted, {"gantry.x": 10})
        except Refusal as error:
            assert error.code in ("not-moving", "ended")
            reply = None
        report = await submitted.result()
        assert report.state == "done", report.reason
        counted = [entry.to for step in report.steps for entry in step.retargets]
        assert counted == ([] if reply is None else [{"gantry.x": 10}])
        on_second = bool(report.steps[1].retargets)
        assert position(fleet, "gantry.x") == pytest.approx(10 if on_second else 30, abs=1e-3)

    run_fleet(main)


def test_a_pause_and_a_stop_while_it_brakes_are_as_for_any_step() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client, submitted = await begin(fleet, FAR, 2.0)
        await submitted.retarget(OTHER)
        await submitted.pause(now=True)
        await wait_for_state(fleet, submitted, "paused")
        stands = position(fleet, "gantry.x")
        await sleep_ns(fleet.clock, 3 * NS_PER_S)
        assert position(fleet, "gantry.x") == stands
        await submitted.resume()
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert position(fleet, "gantry.x") == pytest.approx(40, abs=1e-3)
        assert len(report.steps[0].feed_holds) == len(report.steps[0].retargets) == 1
        _, stopped = await begin(fleet, FAR, 2.0)
        await stopped.retarget({**OTHER, "gantry.x": 20})
        await client.stop()
        assert (await stopped.result()).state == "aborted"
        stands = position(fleet, "gantry.x")
        await sleep_ns(fleet.clock, 3 * NS_PER_S)
        assert position(fleet, "gantry.x") == pytest.approx(stands, abs=0.01)

    run_fleet(main, demo_fleet())


def test_a_pause_at_the_end_of_the_step_comes_there() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        steps = f"{FAR[:-1]}, {{do: move, by: {{gantry.x: 5}}}}]"
        _, submitted = await begin(fleet, steps, 2.0)
        await submitted.retarget(OTHER)
        await submitted.pause()
        await wait_for_state(fleet, submitted, "paused")
        assert position(fleet, "gantry.x") == pytest.approx(40, abs=1e-3)
        await submitted.resume()
        assert (await submitted.result()).state == "done"

    run_fleet(main)


LIMITS = {"velocity": 100, "acceleration": 500, "jerk": 10_000}
PERIOD_NS = 10 * NS_PER_MS
COUNT = 1e-3  # mm


def streaming_fleet() -> Fleet:
    """One CiA 402 drive, which follows positions."""
    drive: dict[str, Any] = {
        "adapter": "cia402",
        "link": {"kind": "can", "interface": "socketcan", "channel": "can0", "address": 1},
        "options": {"cycle_us": 100, "start_us": 50, "start_spread_us": 50},
        "axes": {
            "x": {
                "motors": ["1"],
                "unit": "mm",
                "scale": 1000,
                "limits": LIMITS,
                "soft_limits": {"min": -300, "max": 300},
            }
        },
        "simulate": {"drift_ppm": 30, "options": {"objects": {"6065": 500, "6066": 0}}},
    }
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "streams", "controllers": {"c0": drive}})


class StreamWatch:
    """Compares the positions that a drive follows, period by period, with its limits: each is rounded to a count, and
    reached by a straight line, which is less than a count beside its curve."""

    def __init__(self, fleet: VirtualFleet) -> None:
        unit = fleet.controllers["c0"]
        assert isinstance(unit, SimulatedDrive)
        self._clock = fleet.clock
        self._mover = unit.station.drive.servo.mover
        self._follow = self._mover.follow_target
        self._places: list[float] = []
        self._at_ns = 0
        self.problems: list[str] = []
        self.count = 0

    def __enter__(self) -> "StreamWatch":
        self._mover.follow_target = self._note  # pyright: ignore[reportAttributeAccessIssue]
        return self

    def __exit__(self, *_: object) -> None:
        self._mover.follow_target = self._follow  # pyright: ignore[reportAttributeAccessIssue]

    def _note(self, target: float, period_s: float) -> None:
        now_ns = self._clock.now_ns()
        if now_ns - self._at_ns > 1.5 * PERIOD_NS:
            self._places = []  # it begins from rest, or from a halt
        self._places, self._at_ns = [*self._places[-3:], target * COUNT], now_ns
        self.count += 1
        self._check(self._places)
        self._follow(target, period_s)

    def _check(self, places: list[float]) -> None:
        if len(places) < 4:
            return
        period_s = PERIOD_NS / NS_PER_S
        speeds = [(after - before) / period_s for before, after in pairwise(places)]
        changes = [(after - before) / period_s for before, after in pairwise(speeds)]
        for name, value, rounding in (
            ("velocity", speeds[-1], 2 * COUNT / period_s),
            ("acceleration", changes[-1], 4 * COUNT / period_s**2),
            ("jerk", (changes[1] - changes[0]) / period_s, 8 * COUNT / period_s**3),
        ):
            if abs(value) > LIMITS[name] + rounding:
                self.problems.append(f"{name} {value:.1f} at {places[-1]:.3f}, SYNC {self.count}")


async def retarget_at_random(fleet: VirtualFleet, count: int, seed: int) -> list[StepRetarget]:
    """Retarget a drive again and again, at random instants, also when it stands; the entries of the reports."""
    draw = random.Random(seed)
    assert (await outcome(fleet, job("[{do: enable, axes: [c0]}, {do: home}]"))).state == "done"
    client, entries, left = fleet.make_client(), list[StepRetarget](), count
    while left:
        submitted = await client.submit(job(f"[{{do: move, to: {{c0.x: {draw.uniform(-300, 300):.3f}}}}}]"))
        await wait_for_state(fleet, submitted, "running")
        wanted: float | None = None
        for _ in range(min(left, draw.randint(1, 12))):
            await sleep_ns(fleet.clock, round(draw.choice([0.02, 0.2, 0.7, 1.5]) * draw.random() * NS_PER_S))
            target = round(draw.uniform(-300, 300), 3)
            try:
                assert (await submitted.retarget({"c0.x": target})).outcome == "changed"
            except Refusal as error:
                assert error.code in ("not-moving", "ended"), error
                break
            wanted = target
            left -= 1
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert report.verdict == "green", report.steps[0].deviations
        if wanted is not None:
            assert position(fleet, "c0.x") == pytest.approx(wanted, abs=COUNT)
        entries += report.steps[0].retargets
    return entries


@pytest.mark.parametrize(("count", "seed"), [(20, 1), pytest.param(1000, 2, marks=pytest.mark.nightly)])
def test_a_stream_goes_to_random_targets_on_the_way_within_its_limits(count: int, seed: int) -> None:
    async def main(fleet: VirtualFleet) -> list[StepRetarget]:
        info = await fleet.make_client().axis("c0.x")
        assert (info.retarget.way, info.retarget.within_s) == ("stream", 0.1)
        with StreamWatch(fleet) as watch:
            entries = await retarget_at_random(fleet, count, seed)
        assert watch.count > 100 and not watch.problems, watch.problems[:5]
        return entries

    entries = run_fleet(main, streaming_fleet())
    streamed = [entry for entry in entries if entry.way == "stream"]
    assert len(streamed) >= 0.7 * len(entries)
    assert max(entry.changed_ns or 0 for entry in streamed) <= 10 * PERIOD_NS


def test_a_stream_reverses_without_a_rest_and_the_step_behind_it_follows_at_once() -> None:
    async def main(fleet: VirtualFleet) -> JobReport:
        assert (await outcome(fleet, job("[{do: enable, axes: [c0]}, {do: home}]"))).state == "done"
        steps = "[{do: move, to: {c0.x: 200}}, {do: move, by: {c0.x: 7}}]"
        _, submitted = await begin(fleet, steps, 0.8)
        reply = await submitted.retarget({"c0.x": 10})
        assert (reply.outcome, reply.way, reply.within_s) == ("changed", "stream", 0.1)
        assert (await submitted.retarget({"c0.x": 10})).outcome == "same"
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert position(fleet, "c0.x") == pytest.approx(17, abs=COUNT)
        recording = await fleet.make_client().load_recording(submitted, 0)
        assert recording is not None
        low, high = recording.axes["c0.x"].profile.extent_counts
        assert low == pytest.approx(0, abs=1) and 10_000 < high < 200_000
        return report

    first, second = run_fleet(main, streaming_fleet()).steps
    assert first.verdict == second.verdict == "green" and first.deviations == []
    assert first.retargets[0].before == {"c0.x": 200} and first.positions["c0.x"].position == pytest.approx(
        10, abs=0.01
    )
    assert second.chain is not None and second.chain.step == 0


@pytest.mark.parametrize("what", ["pause", "stop", "estop"])
def test_what_stops_a_step_stops_a_continued_stream(what: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, job("[{do: enable, axes: [c0]}, {do: home}]"))).state == "done"
        client, submitted = await begin(fleet, "[{do: move, to: {c0.x: 200}}]", 0.8)
        assert (await submitted.retarget({"c0.x": 10})).way == "stream"
        if what == "pause":
            await submitted.pause(now=True)
            await wait_for_state(fleet, submitted, "paused")
            await submitted.resume()
            assert (await submitted.result()).state == "done"
            assert position(fleet, "c0.x") == pytest.approx(10, abs=COUNT)
            return
        await (client.stop() if what == "stop" else client.estop())
        assert (await submitted.result()).state in ("aborted", "failed")
        stands = position(fleet, "c0.x")
        await sleep_ns(fleet.clock, 3 * NS_PER_S)
        assert position(fleet, "c0.x") == pytest.approx(stands, abs=COUNT)
        assert stands > 20

    run_fleet(main, streaming_fleet())


def test_two_streams_brake_together() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (
            await outcome(fleet, job("[{do: enable, axes: [c0, c2]}, {do: home, axes: [c0.x, c2.x]}]"))
        ).state == "done"
        _, submitted = await begin(fleet, "[{do: move, to: {c0.x: 200, c2.x: -90}, speed: 0.5}]", 1.0)
        assert (await submitted.retarget({"c0.x": 20, "c2.x": 30})).way == "brake"
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert position(fleet, "c0.x") == pytest.approx(20, abs=COUNT)
        assert position(fleet, "c2.x") == pytest.approx(30, abs=COUNT)

    run_fleet(main, streams_and_contour())
