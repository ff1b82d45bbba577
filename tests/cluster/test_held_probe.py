"""Probes of axes of several controllers, which the coordinator brakes, against the truth of the simulators."""

from collections.abc import Awaitable, Callable
from random import Random

import pytest
from cluster.worlds import drive_fleet, job, origin_host_ns, run_fleet

from orchestrator.client.api import Tutti
from orchestrator.client.steps import JobFailed
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.coordinator.motion.step import MotionStep
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.report import JobReport, ProbeReport
from orchestrator.model.state import StepCosts
from orchestrator.model.steps.probe import Probe
from orchestrator.plan.held_probes import find_held_times
from orchestrator.plan.probes import ProbeAbilities
from orchestrator.runtime.virtual.fleet import VirtualFleet

BEGIN_MM = 10.0
LINE = "{do: probe, name: EDGE, to: {gantry.x: 16, lift.z: 18}, until: gantry.touch, speed: 5 mm/s, by: host}"
WITH_STAGE = LINE.replace("lift.z", "stage.u")


def with_touches() -> Fleet:
    plain = drive_fleet("touch").to_plain()
    plain["controllers"]["gantry"]["inputs"] = {"touch": {"number": 5, "active": "high"}}
    plain["controllers"]["stage"]["inputs"] = {"touch": {"number": 1, "active": "high"}}
    return Fleet.model_validate(plain)


class Line:
    """Axes at 10 mm, and a contact that closes an input when the first axis has moved far enough. made: where all of
    them were then, mm; made_ns: when, true time."""

    def __init__(self, virtual: VirtualFleet, client: Tutti, axes: list[str]) -> None:
        self.virtual = virtual
        self.client = client
        self.axes = axes
        self.starts = self._find_counts()
        self.made: dict[str, float] = {}
        self.made_ns = 0

    def _find_counts(self) -> dict[str, float]:
        fleet, units = self.virtual.fleet, self.virtual.controllers
        return {name: units[controller_of(name)].physical_position(fleet.axis(name).motors[0]) for name in self.axes}

    def find_places(self) -> dict[str, float]:
        """Where the axes are by truth, mm."""
        counts, fleet = self._find_counts(), self.virtual.fleet
        return {
            name: BEGIN_MM + (counts[name] - self.starts[name]) / float(fleet.axis(name).scale) for name in self.axes
        }

    @property
    def is_moving(self) -> bool:
        """Whether any of them moves."""
        fleet, units = self.virtual.fleet, self.virtual.controllers
        return any(units[controller_of(name)].is_moving(fleet.axis(name).motors[0]) for name in self.axes)

    def close(self, until: str, *, level: bool) -> None:
        """Switch an input."""
        controller, _, name = until.partition(".")
        number = self.virtual.fleet.controllers[controller].inputs[name].number
        self.virtual.act_on_controller(controller, lambda unit: unit.set_input(number, level=level))

    def put_contact(self, until: str, distance_mm: float, lasts_ns: int | None = None) -> None:
        """Close an input when the first axis has come so far."""
        places = self.find_places()
        left_mm = distance_mm - (places[self.axes[0]] - BEGIN_MM)
        if left_mm > 0:
            pause_ns = min(5 * NS_PER_MS, max(20_000, round(left_mm / 10 * NS_PER_S)))
            again_ns = self.virtual.clock.now_ns() + pause_ns
            self.virtual.clock.call_at_ns(again_ns, lambda: self.put_contact(until, distance_mm, lasts_ns))
            return
        self.made, self.made_ns = places, self.virtual.clock.now_ns()
        self.close(until, level=True)
        if lasts_ns is not None:
            self.virtual.clock.call_at_ns(self.made_ns + lasts_ns, lambda: self.close(until, level=False))

    async def run(self, *steps: str) -> JobReport:
        """Run a job; its report, also of one that fails."""
        try:
            return await self.client.run(job(f"[{', '.join(steps)}]"))
        except JobFailed as failed:
            return failed.report

    def check(self, probe: ProbeReport) -> None:
        """Check a report against the truth."""
        places, made_ns = self.find_places(), self.made_ns - origin_host_ns(self.virtual)
        assert probe.touched and probe.seen is not None
        assert probe.seen.earliest_ns <= made_ns <= probe.seen.latest_ns
        for report in (probe, *probe.others):
            name = report.axis
            assert report.least <= self.made[name] <= report.most
            assert places[name] - self.made[name] <= report.overtravel <= report.stated
            assert report.rest == pytest.approx(places[name], abs=0.003)

    def find_off_line(self, ends: dict[str, float]) -> dict[str, float]:
        """How far each axis is from where the line is at the place of the first one, mm."""
        first, places = self.axes[0], self.find_places()
        part = (places[first] - BEGIN_MM) / (ends[first] - BEGIN_MM)
        return {name: abs(places[name] - BEGIN_MM - part * (ends[name] - BEGIN_MM)) for name in self.axes}


def run_line(main: Callable[[Line], Awaitable[None]], axes: list[str], seed: int = 1) -> None:
    fleet = with_touches()

    async def prepare(virtual: VirtualFleet) -> None:
        client, names = virtual.make_client("operator"), ", ".join(dict.fromkeys(map(controller_of, axes)))
        places = ", ".join(f"{name}: {BEGIN_MM}" for name in axes)
        ready = (
            f"{{do: enable, axes: [{names}]}}, {{do: home, axes: [{', '.join(axes)}]}}, {{do: move, to: {{{places}}}}}"
        )
        line = Line(virtual, client, axes)
        for controller in ("gantry", "stage", "lift"):
            line.close(f"{controller}.touch", level=False)
        await client.run(job(f"[{ready}]"))
        line.starts = Line(virtual, client, axes).starts
        await main(line)

    run_fleet(prepare, fleet, seed)


async def require_contact(line: Line, step: str, distance_mm: float, ends: dict[str, float]) -> None:
    """Probe, and compare all that is stated with the truth."""
    until = step.partition("until: ")[2].partition(",")[0]
    line.put_contact(until, distance_mm)
    forecast = await line.client.dry_run(job(f"[{step}]"))
    assert not forecast.problems, forecast.problems
    notes = " ".join(note for each in forecast.steps for note in each.conditions)
    report = await line.run(step)
    assert report.state == "done", report.reason
    probe = report.steps[0].probe
    assert probe is not None and [one.axis for one in (probe, *probe.others)] == line.axes
    line.check(probe)
    for name, off_mm in line.find_off_line(ends).items():
        stated = notes.partition(f"{name} goes on by at most ")[2]
        assert float(stated.split(" mm")[0]) == pytest.approx(
            next(one.stated for one in (probe, *probe.others) if one.axis == name), rel=0.01
        )
        assert off_mm <= float(stated.partition("off its line by at most ")[2].split(" mm")[0])


@pytest.mark.parametrize(
    ("axes", "until"),
    [
        (["gantry.x", "lift.z"], "gantry.touch"),
        (["gantry.x", "stage.u"], "gantry.touch"),
        (["gantry.x", "lift.z"], "stage.touch"),
        (["gantry.x", "gantry.y"], "lift.touch"),
    ],
)
def test_axes_of_a_line_stop_behind_a_contact_within_what_was_stated(axes: list[str], until: str) -> None:
    async def main(line: Line) -> None:
        step = LINE.replace("lift.z", axes[1]).replace("gantry.touch", until)
        await require_contact(line, step, 2.5, {axes[0]: 16, axes[1]: 18})

    run_line(main, axes)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(20))
def test_axes_of_a_line_stop_in_more_seeds(seed: int) -> None:
    draw = Random(seed)
    axes = ["gantry.x", draw.choice(["lift.z", "stage.u", "gantry.y"])]
    until = draw.choice(["gantry.touch", "lift.touch"] if axes[1] == "stage.u" else ["gantry.touch", "stage.touch"])
    ends = {axes[0]: draw.choice([14.0, 20.0]), axes[1]: draw.choice([5.0, 15.0, 18.0])}
    speed = draw.choice([1, 3, 5])

    async def main(line: Line) -> None:
        step = f"{{do: probe, to: {{{axes[0]}: {ends[axes[0]]}, {axes[1]}: {ends[axes[1]]}}}, until: {until}"
        await require_contact(line, f"{step}, speed: {speed} mm/s, by: host}}", draw.uniform(0.5, 3), ends)

    run_line(main, axes, seed)


def test_later_steps_go_to_the_contact_of_each_axis() -> None:
    async def main(line: Line) -> None:
        line.put_contact("gantry.touch", 2, 300 * NS_PER_MS)
        move = "{do: move, to: {gantry.x: {of: EDGE.x, plus: -1 mm}, lift.z: {of: EDGE.z}}}"
        report = await line.run(LINE, move)
        assert report.state == "done", report.reason
        probe, places = report.steps[0].probe, line.find_places()
        assert probe is not None
        (z,) = probe.others
        assert places["gantry.x"] == pytest.approx((probe.least + probe.most) / 2 - 1, abs=0.003)
        assert places["lift.z"] == pytest.approx((z.least + z.most) / 2, abs=0.003)

    run_line(main, ["gantry.x", "lift.z"])


def test_what_a_held_line_cannot_do_is_refused_and_nothing_moves() -> None:
    async def main(line: Line) -> None:
        line.close("gantry.touch", level=True)
        await sleep_ns(line.virtual.clock, NS_PER_S)
        begins = line.find_places()
        for step, code, words in (
            (WITH_STAGE, "line-level", "gantry.touch is active already"),
            (WITH_STAGE.replace("gantry.touch", "stage.touch"), "no-probe", "does not show its inputs while it moves"),
            (WITH_STAGE.replace("16", "399.9"), "soft-limit", "gantry.x"),
        ):
            refused = (await line.run(step)).steps[-1].refused
            assert refused is not None and refused.code == code and words in refused.text, refused
        assert line.find_places() == begins

    run_line(main, ["gantry.x", "stage.u"])


def test_a_line_without_a_contact_ends_at_its_end_and_one_that_is_lost_again_is_one() -> None:
    async def main(line: Line) -> None:
        begins = line.find_places()
        report = await line.run(LINE.replace("16", "20").replace("18", "11").replace("speed: 5", "speed: 1"))
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == "path-error" and "lift.z at 99.5" in refused.text, refused
        assert line.find_places() == begins
        report = await line.run(LINE.replace("speed: 5", "speed: 20"))
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == "not-touched" and "16 mm of gantry.x" in refused.text, refused
        back = LINE.replace("16", "10").replace("18", "10").replace("5 mm/s", "20 mm/s, else: continue")
        report = await line.run(back)
        probe = report.steps[0].probe
        assert report.state == "done" and probe is not None and not probe.touched
        assert (probe.rest, probe.others[0].rest) == (10, 10)
        # Longer than the period of the readings, 100 ms; the axes rest some 80 ms behind the one that shows it.
        line.put_contact("gantry.touch", 21, 110 * NS_PER_MS)
        fast = LINE.replace("16", "60").replace("18", "80").replace("5 mm/s", "40 mm/s")
        probe = (await line.run(fast)).steps[0].probe
        assert probe is not None and probe.released
        line.check(probe)

    run_line(main, ["gantry.x", "lift.z"])


@pytest.mark.parametrize("how", ["stop", "estop", "cut-input", "kill-host", "kill-coordinator"])
def test_a_fault_leaves_no_axis_of_a_held_line_in_motion(how: str) -> None:
    async def main(line: Line) -> None:
        virtual, step = line.virtual, LINE.replace("gantry.touch", "stage.touch")
        submitted = await line.client.submit(job(f"[{step}]"))
        while not line.is_moving:
            await sleep_ns(virtual.clock, 10 * NS_PER_MS)
        await sleep_ns(virtual.clock, 300 * NS_PER_MS)
        begins = line.find_places()
        if how == "stop":
            await line.client.stop()
        elif how == "estop":
            await line.client.estop("a test")
        elif how == "cut-input":
            virtual.wires["stage"].cut = True
        elif how == "kill-host":
            virtual.kill(f"host/{virtual.fleet.controllers['stage'].host}")
        else:
            virtual.kill("coordinator/first")
        await sleep_ns(virtual.clock, round(1.2 * NS_PER_S))
        assert not line.is_moving
        # By 5 mm/s: the stop at once; or the time without a reading, or without a heartbeat, and the stop.
        ways = [place - begin for place, begin in zip(line.find_places().values(), begins.values(), strict=True)]
        assert 0 < max(ways) <= {"stop": 0.5, "estop": 0.5}.get(how, 4.0), ways
        if how == "cut-input":
            report = await submitted.result()
            assert report.state == "failed" and "stage.touch" in report.reason, report.reason

    run_line(main, ["gantry.x", "lift.z"])


def test_a_stop_that_comes_too_late_is_found(monkeypatch: pytest.MonkeyPatch) -> None:
    """Mutation: the coordinator waits before it stops the axes."""
    hold = MotionStep.feed_hold

    async def main(line: Line) -> None:
        async def hold_late(motion: MotionStep, actor: str) -> None:
            if motion.motion is not None and motion.motion.start.state.paused_by is None:
                await sleep_ns(line.virtual.clock, NS_PER_S // 2)
            await hold(motion, actor)

        monkeypatch.setattr(MotionStep, "feed_hold", hold_late)
        line.put_contact("gantry.touch", 1)
        refused = (await line.run(LINE)).steps[-1].refused
        assert refused is not None and refused.code == "overtravel", refused

    run_line(main, ["gantry.x", "lift.z"])


def test_a_controller_whose_stop_has_no_bound_is_refused_by_name() -> None:
    fleet = with_touches()
    step = Probe(to={"gantry.x": 1, "lift.z": 2}, until="gantry.touch", speed="1 mm/s", by="host")

    def make(stop_s: float) -> ProbeAbilities:
        costs = StepCosts(arm_ns=1, disarm_ns=1, stop_ns=round(stop_s * NS_PER_S))
        return ProbeAbilities("acme", costs, None, None, None, None, shows_inputs=True)

    times = find_held_times(fleet, step, {"gantry": make(0.3), "lift": make(0.21)})
    assert times.leads_s == {"gantry": pytest.approx(0.1), "lift": pytest.approx(0.11)}
    with pytest.raises(Refusal, match="lift: a stop takes at most"):
        find_held_times(fleet, step, {"gantry": make(0.3), "lift": make(0.05)})
