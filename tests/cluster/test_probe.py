"""Probes, against the truth of simulated contacts."""

from collections.abc import Awaitable, Callable, Sequence
from dataclasses import dataclass

import pytest
from cluster.worlds import changed, demo_fleet, drive_fleet, job, origin_host_ns, run_fleet

from orchestrator.client.api import Tutti
from orchestrator.client.steps import JobFailed
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.names import controller_of
from orchestrator.model.report import JobReport, ProbeReport
from orchestrator.runtime.simulated_fleets import make_smc30, make_smc2000
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.contact import ContactPlace, PhysicalContact

READY = "{do: enable, axes: [gantry]}, {do: home, axes: [gantry]}, {do: move, to: {gantry.x: 10}}"
PROBE = "{do: probe, name: edge, to: {gantry.x: 15}, until: gantry.touch, speed: 1 mm/s}"


def with_touch(active: str = "low", number: int = 1) -> Fleet:
    return changed(demo_fleet(), gantry={"inputs": {"touch": {"number": number, "active": active}}})


@dataclass
class Bench:
    """A fleet whose axis can run into a contact. start: where the axis was made ready, physical counts."""

    virtual: VirtualFleet
    client: Tutti
    axis: str
    motor: str
    start: float
    contact: PhysicalContact | None = None

    def put_contact(self, distance_counts: float, bounces_ns: Sequence[int] = ()) -> None:
        """Put a contact so far from where the axis stands now."""
        controller = controller_of(self.axis)
        unit, process = self.virtual.controllers[controller], self.virtual.simulators[controller]
        at = unit.physical_position(self.motor) + distance_counts
        side = 1 if distance_counts >= 0 else -1
        (point,) = self.virtual.fleet.controllers[controller].inputs.values()
        level = point.active == "high"
        process.run_inside(lambda: unit.set_input(point.number, level=not level))
        place = ContactPlace(self.motor, at, side, point.number, level=level, bounces_ns=bounces_ns)
        self.contact = process.run_inside(lambda: PhysicalContact(unit, self.virtual.clock, place))

    async def run(self, *steps: str) -> JobReport:
        """Run a job; its report, also of one that fails."""
        try:
            return await self.client.run(job(f"[{', '.join(steps)}]"))
        except JobFailed as failed:
            return failed.report

    async def probe(self, step: str = PROBE) -> ProbeReport:
        report = await self.run(step)
        assert report.state == "done", report.reason
        probed = report.steps[0].probe
        assert probed is not None
        return probed

    def find_rest(self) -> float:
        """Where the axis is by truth, physical counts."""
        return self.virtual.controllers[controller_of(self.axis)].physical_position(self.motor)


def run_bench(
    main: Callable[[Bench], Awaitable[None]], fleet: Fleet | None = None, axis: str = "gantry.x", ready: str = READY
) -> None:
    fleet = fleet or with_touch()

    async def prepare(virtual: VirtualFleet) -> None:
        client = virtual.make_client("operator")
        (motor,) = fleet.axis(axis).motors
        bench = Bench(virtual, client, axis, motor, 0.0)
        await client.run(job(f"[{ready}]"))
        bench.start = bench.find_rest()
        await main(bench)

    run_fleet(prepare, fleet)


@pytest.mark.parametrize("bounces_ms", [(), (1, 2, 3, 1), (20, 40)])
def test_a_probe_finds_the_contact_and_stops_within_what_was_stated(bounces_ms: tuple[int, ...]) -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(2500, [each * NS_PER_MS for each in bounces_ms])
        probed = await bench.probe()
        assert bench.contact is not None
        (made, *_) = bench.contact.made
        # The axis began at 10 mm.
        true_mm = 10 + (made.counts - bench.start) / 1000
        assert probed.touched and probed.least <= true_mm <= probed.most
        assert probed.most - probed.least <= 0.010
        assert probed.seen is not None
        made_ns = made.at_ns - origin_host_ns(bench.virtual)
        assert probed.seen.earliest_ns <= made_ns + 25_000 and made_ns <= probed.seen.latest_ns
        true_overtravel = (bench.find_rest() - made.counts) / 1000
        assert 0 < true_overtravel <= probed.stated < 0.02
        assert true_overtravel <= probed.overtravel <= probed.stated
        assert not probed.released

    run_bench(main)


@pytest.mark.parametrize("speed", ["0.2 mm/s", "5 mm/s", "50 mm/s"])
def test_a_probe_in_the_negative_direction_at_other_speeds(speed: str) -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(-2500)
        probed = await bench.probe(f"{{do: probe, to: {{gantry.x: 5}}, until: gantry.touch, speed: {speed}}}")
        assert bench.contact is not None
        (made, *_) = bench.contact.made
        true_mm = 10 + (made.counts - bench.start) / 1000
        assert probed.touched and probed.least <= true_mm <= probed.most
        assert 0 < made.counts - bench.find_rest() <= probed.stated * 1000

    run_bench(main)


def test_a_contact_that_is_lost_again_while_the_axis_brakes_is_one() -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(2500, [NS_PER_MS])
        probed = await bench.probe()
        assert probed.touched and probed.released

    run_bench(main)


@pytest.mark.parametrize(
    ("step", "fleet", "code", "words"),
    [
        (PROBE, with_touch(), "not-touched", "gantry.touch has not become active up to 15 mm of gantry.x"),
        (PROBE, with_touch("high"), "latch-input", "falling edge"),
        (PROBE.replace("15", "399.999"), with_touch(), "soft-limit", "a contact there ends it at 400.009"),
    ],
)
def test_what_a_probe_cannot_do_is_refused_by_name(step: str, fleet: Fleet, code: str, words: str) -> None:
    async def main(bench: Bench) -> None:
        if fleet.controllers["gantry"].inputs["touch"].active == "high":
            bench.virtual.act_on_controller("gantry", lambda unit: unit.set_input(1, level=False))
        report = await bench.run(step)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == code and words in refused.text, refused
        moved = code == "not-touched"
        assert abs(bench.find_rest() - bench.start) == (5000 if moved else 0)

    run_bench(main, fleet)


def test_an_input_that_is_active_before_the_start_is_refused() -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(0)
        report = await bench.run(PROBE)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == "line-level" and "active already" in refused.text
        assert bench.find_rest() == bench.start

    run_bench(main)


def test_a_probe_that_touches_nothing_may_go_on() -> None:
    async def main(bench: Bench) -> None:
        probed = await bench.probe(PROBE.replace("speed", "else: continue, speed"))
        assert not probed.touched and probed.rest == 15 and probed.seen is None

    run_bench(main)


@pytest.mark.parametrize("how", ["stop", "estop", "job"])
def test_a_stop_ends_a_probe(how: str) -> None:
    async def main(bench: Bench) -> None:
        submitted = await bench.client.submit(job(f"[{PROBE}]"))
        await sleep_ns(bench.virtual.clock, 2000 * NS_PER_MS)
        assert bench.virtual.controllers["gantry"].is_moving("X")
        if how == "stop":
            await bench.client.stop()
        elif how == "estop":
            await bench.client.estop("a test")
        else:
            await bench.client.cancel_job(submitted.id)
        await sleep_ns(bench.virtual.clock, 100 * NS_PER_MS)
        assert not bench.virtual.controllers["gantry"].is_moving("X")
        if how == "estop":
            return
        report = await submitted.result()
        assert report.state in ("aborted", "failed", "cancelled"), report.reason
        # Nothing of it is left: a contact ends no later move.
        await bench.client.reset()
        bench.put_contact(1000)
        await bench.client.run(job("[{do: enable, axes: [gantry]}, {do: move, to: {gantry.x: 20}}]"))

    run_bench(main)


# By the host


STAGE_READY = "{do: enable, axes: [stage]}, {do: home, axes: [stage]}, {do: move, to: {stage.u: 10}}"
STAGE_PROBE = "{do: probe, to: {stage.u: 15}, until: stage.touch, speed: 1 mm/s}"


def with_stage_touch() -> Fleet:
    return changed(demo_fleet(), stage={"inputs": {"touch": {"number": 1, "active": "high"}}})


def test_a_make_that_cannot_stop_by_an_input_is_refused_without_by_host() -> None:
    async def main(bench: Bench) -> None:
        report = await bench.run(STAGE_PROBE)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == "no-probe" and "by: host" in refused.remedy
        assert "the make shrc203 cannot stop an axis by an input" in refused.text
        assert bench.find_rest() == bench.start

    run_bench(main, with_stage_touch(), "stage.u", STAGE_READY)


@pytest.mark.parametrize("speed", ["1 mm/s", "5 mm/s"])
def test_a_host_stops_an_axis_within_what_was_stated(speed: str) -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(25_000)
        probed = await bench.probe(STAGE_PROBE.replace("1 mm/s", f"{speed}, by: host"))
        assert bench.contact is not None and bench.contact.made, probed
        (made, *_) = bench.contact.made
        true_mm = 10 + (made.counts - bench.start) / 10_000
        assert probed.touched and probed.by == "host" and probed.least <= true_mm <= probed.most
        assert 0 < (bench.find_rest() - made.counts) / 10_000 <= probed.stated

    run_bench(main, with_stage_touch(), "stage.u", STAGE_READY)


# A CiA 402 drive, by its touch probe

LIFT_READY = "{do: enable, axes: [lift]}, {do: home, axes: [lift.z]}, {do: move, to: {lift.z: 10}}"
LIFT_PROBE = "{do: probe, to: {lift.z: 15}, until: lift.touch, speed: 1 mm/s}"


@pytest.mark.parametrize("active", ["high", "low"])
@pytest.mark.parametrize("speed", ["1 mm/s", "20 mm/s"])
def test_a_drive_captures_the_contact_and_is_halted(active: str, speed: str) -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(2500, [NS_PER_MS, NS_PER_MS])
        probed = await bench.probe(LIFT_PROBE.replace("1 mm/s", speed))
        assert bench.contact is not None
        (made, *_) = bench.contact.made
        true_mm = 10 + (made.counts - bench.start) / 1000
        assert probed.touched and probed.least <= true_mm <= probed.most and probed.most - probed.least < 0.005
        assert 0 < (bench.find_rest() - made.counts) / 1000 <= probed.stated
        moved = await bench.run("{do: move, to: {lift.z: 5}}")
        assert moved.state == "done", moved.reason

    run_bench(main, drive_fleet("touch", active), "lift.z", LIFT_READY)


@pytest.mark.parametrize(
    ("fleet", "code", "words"),
    [
        (drive_fleet("touch"), "not-touched", "up to 15 mm"),
        (drive_fleet("touch", number=3), "probe-input", "input 1 or input 2"),
        (drive_fleet("touch", without=("60B8", "60B9")), "no-latch", "no touch probe"),
    ],
)
def test_what_a_drive_cannot_probe_is_refused(fleet: Fleet, code: str, words: str) -> None:
    async def main(bench: Bench) -> None:
        report = await bench.run(LIFT_PROBE)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == code and words in refused.text, refused

    run_bench(main, fleet, "lift.z", LIFT_READY)


def test_a_drive_that_touches_already_is_refused() -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(0)
        report = await bench.run(LIFT_PROBE)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == "line-level" and bench.find_rest() == bench.start

    run_bench(main, drive_fleet("touch"), "lift.z", LIFT_READY)


def test_a_probe_until_the_input_is_passive() -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(-2500)  # made between 7.5 mm and below
        await bench.run("{do: move, to: {lift.z: 5}}")
        probed = await bench.probe(LIFT_PROBE.replace("speed", "level: passive, speed"))
        assert probed.touched and probed.least <= 7.5 <= probed.most

    run_bench(main, drive_fleet("touch"), "lift.z", LIFT_READY)


# What later steps use

EDGE = "{do: probe, name: EDGE, to: {gantry.x: 15}, until: gantry.touch, speed: 1 mm/s}"


def test_later_steps_go_to_what_was_measured() -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(2500)
        report = await bench.run(
            EDGE,
            "{do: move, to: {gantry.x: {of: EDGE.x, plus: -5 mm}, gantry.y: 3}}",
            "{do: set-position, axes: {gantry.x: -5 mm}}",
            # The contact stays where it is, and is the user's 0 now.
            "{do: probe, name: AGAIN, to: {gantry.x: {of: EDGE.x, plus: 1 mm}}, until: gantry.touch, speed: 0.5 mm/s}",
            "{do: move, to: {gantry.x: {of: [EDGE.x, AGAIN.gantry.x], between: [-1 mm, 1 mm]}}}",
        )
        assert report.state == "done", report.reason
        probed = report.steps[3].probe
        assert probed is not None and probed.least <= 0.001 and probed.most >= -0.001
        assert bench.contact is not None
        assert abs(bench.find_rest() - bench.contact.made[0].counts) <= 2
        assert bench.virtual.controllers["gantry"].position("Y") == 3000

    run_bench(main)


def test_a_contact_is_saved_as_a_position_for_later_jobs() -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(2500)
        saving = "{do: save-position, position: edge, axes: {gantry.x: {of: EDGE.x, plus: -1 mm}, gantry.y: null}}"
        report = await bench.run(EDGE, saving)
        assert report.state == "done", report.reason
        (saved,) = [entry for entry in await bench.client.list_positions() if entry.source == "saved"]
        assert saved.name == "edge" and saved.actor == "operator" and saved.axes["gantry.y"] == "0 mm"
        moved = await bench.run("{do: move, to: edge}")
        assert moved.state == "done", moved.reason
        assert bench.contact is not None
        assert bench.find_rest() == pytest.approx(bench.contact.made[0].counts - 1000, abs=2)
        # A contact that was not found replaces nothing.
        report = await bench.run(EDGE.replace("15}", "12}").replace("speed", "else: continue, speed"), saving)
        assert report.steps[-1].refused is not None and report.steps[-1].refused.code == "not-measured"
        (again,) = [entry for entry in await bench.client.list_positions() if entry.source == "saved"]
        assert again == saved

    run_bench(main)


@pytest.mark.parametrize(
    ("axes", "words"),
    [
        ("{gantry.x: {of: EDGE.x, plus: -21 mm}}", "target -11 mm is beyond its soft limits -10 to 400 mm"),
        ("{gantry.x: {of: EDGE.x, between: [-20 mm, 12 mm]}}", "target -20 mm is beyond its soft limits"),
        ("{gantry.x: 500}", "target 500 mm is beyond its soft limits"),
        ("{gantry.x: 5, gantry.q: null}", "gantry.q"),
    ],
)
def test_a_position_that_is_saved_is_checked_for_its_whole_range(axes: str, words: str) -> None:
    async def main(bench: Bench) -> None:
        saving = f"{{do: save-position, position: edge, axes: {axes}}}"
        forecast = await bench.client.dry_run(job(f"[{EDGE}, {saving}]"))
        assert words in forecast.problems[0].text

    run_bench(main)


def test_a_dry_run_states_the_range_of_what_is_saved() -> None:
    async def main(bench: Bench) -> None:
        saving = "{do: save-position, position: edge, axes: {gantry.x: {of: EDGE.x, plus: -5 mm}}}"
        forecast = await bench.client.dry_run(job(f"[{EDGE}, {saving}]"))
        assert not forecast.problems
        assert forecast.steps[1].conditions == ["edge has gantry.x at EDGE.x + -5 mm, between 5 and 10 mm"]

    run_bench(main)


@pytest.mark.parametrize("target", ["to: {gantry.x: -16}", "by: {gantry.x: -21}"])
def test_what_follows_a_zero_at_a_contact_is_checked_for_its_whole_range(target: str) -> None:
    async def main(bench: Bench) -> None:
        # The zero is set somewhere from 10 mm to 15 mm; the soft limit is at -10 mm.
        asked = f"[{EDGE}, {{do: set-position, axes: {{gantry.x: 5}}}}, {{do: move, {target}}}]"
        forecast = await bench.client.dry_run(job(asked))
        assert [problem.code for problem in forecast.problems] == ["soft-limit"], forecast.problems
        fine = await bench.client.dry_run(job(asked.replace("-16", "-14").replace("-21", "-19")))
        assert not fine.problems

    run_bench(main)


def test_a_position_is_not_used_in_the_job_that_saves_it() -> None:
    saving = "{do: save-position, position: edge, axes: {gantry.x: {of: EDGE.x}}}"
    going = "{do: move, to: {gantry.x: edge}}"
    with pytest.raises(ValueError, match="edge is saved by a step before it, and is taken once, when the job begins"):
        job(f"[{EDGE}, {saving}, {going}]")
    assert job(f"[{going}, {EDGE}, {saving}]").steps[0] == job(f"[{going}]").steps[0]


@pytest.mark.parametrize(
    ("steps", "code", "words"),
    [
        (
            f"{EDGE.replace('speed', 'else: continue, speed')}, {{do: move, to: {{gantry.x: {{of: EDGE.x}}}}}}",
            "not-measured",
            "EDGE.x is not known: gantry.touch was not touched",
        ),
        (
            f"{EDGE}, {{do: move, to: {{gantry.x: {{of: EDGE.x, between: [13 mm, 15 mm]}}}}}}",
            "measured-bounds",
            "is at 12.4999",
        ),
        (
            f"{EDGE}, {{do: move, to: {{gantry.x: {{of: EDGE.x, plus: 1 s}}}}}}",
            None,
            "",
        ),
    ],
)
def test_what_was_not_measured_moves_nothing(steps: str, code: str | None, words: str) -> None:
    async def main(bench: Bench) -> None:
        if code is None:
            with pytest.raises(Exception, match="unit"):
                job(f"[{steps}]")
            return
        if code == "measured-bounds":
            bench.put_contact(2500)
        report = await bench.run(steps)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == code and words in refused.text, report.reason

    run_bench(main)


def test_a_job_is_checked_for_the_whole_range_of_what_is_measured() -> None:
    async def main(bench: Bench) -> None:
        asked = job(f"[{EDGE}, {{do: move, to: {{gantry.x: {{of: EDGE.x, plus: -21 mm}}}}}}]")
        forecast = await bench.client.dry_run(asked)
        # The contact may be anywhere from 10 mm to 15 mm.
        assert [problem.text for problem in forecast.problems] == [
            "axis gantry.x: target -11 mm is beyond its soft limits -10 to 400 mm"
        ]
        fine = await bench.client.dry_run(job(f"[{EDGE}, {{do: move, to: {{gantry.x: {{of: EDGE.x, plus: -5 mm}}}}}}]"))
        assert not fine.problems
        assert "gantry.x goes on by at most 0.00969 mm behind the contact" in fine.steps[0].conditions
        assert "gantry.x goes to EDGE.x + -5 mm, between 5 and 10 mm" in fine.steps[1].conditions

    run_bench(main)


# An SMC-2000 on its serial line


def with_press(number: int = 1, address: int | None = None) -> Fleet:
    press = make_smc2000(0, address)
    press["inputs"] = {"touch": {"number": number, "active": "low"}}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "press", "controllers": {"press": press}})


PRESS_READY = "{do: enable, axes: [press]}, {do: home, axes: [press]}, {do: move, to: {press.x: 10}}"


@pytest.mark.parametrize("address", [None, 0])
def test_an_smc2000_stops_by_its_latch(address: int | None) -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(2500)
        probed = await bench.probe("{do: probe, to: {press.x: 15}, until: press.touch, speed: 1 mm/s}")
        assert bench.contact is not None
        (made, *_) = bench.contact.made
        true_mm = 10 + (made.counts - bench.start) / 1000
        assert probed.touched and probed.least <= true_mm <= probed.most
        assert 0 < (bench.find_rest() - made.counts) / 1000 <= probed.stated < 0.02
        moved = await bench.run("{do: move, to: {press.x: 20}}")  # through the contact, which is armed no more
        assert moved.state == "done", moved.reason

    run_bench(main, with_press(address=address), "press.x", PRESS_READY)


@pytest.mark.parametrize(
    ("number", "more", "words"),
    [
        (2, "", "press.touch is input 2, which does not stop press.x; input 1 does"),
        (1, ", level: passive", "stops an axis when an input becomes active only"),
    ],
)
def test_what_an_smc2000_cannot_stop_by_is_refused(number: int, more: str, words: str) -> None:
    async def main(bench: Bench) -> None:
        report = await bench.run(f"{{do: probe, to: {{press.x: 15}}, until: press.touch, speed: 1 mm/s{more}}}")
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == "probe-input" and words in refused.text, refused
        assert bench.find_rest() == bench.start

    run_bench(main, with_press(number), "press.x", PRESS_READY)


# An SMC30, by its stop condition


def with_screw(active: str = "high") -> Fleet:
    screw = make_smc30(0, 1)
    screw["inputs"] = {"touch": {"number": 2, "active": active}}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "screw", "controllers": {"screw": screw}})


SCREW_READY = "{do: enable, axes: [screw]}, {do: home, axes: [screw]}, {do: move, to: {screw.x: 10}}"
SCREW_PROBE = "{do: probe, to: {screw.x: 15}, until: screw.touch, speed: 2 mm/s}"


@pytest.mark.parametrize("speed", ["2 mm/s", "8 mm/s"])
def test_an_smc30_stops_by_its_stop_condition(speed: str) -> None:
    async def main(bench: Bench) -> None:
        steps = float(bench.virtual.fleet.axis("screw.x").scale)
        bench.put_contact(2.5 * steps)
        probed = await bench.probe(SCREW_PROBE.replace("2 mm/s", speed))
        assert bench.contact is not None
        (made, *_) = bench.contact.made
        true_mm = 10 + (made.counts - bench.start) / steps
        assert probed.touched and probed.least <= true_mm <= probed.most
        assert 0 <= (bench.find_rest() - made.counts) / steps <= probed.stated

    run_bench(main, with_screw(), "screw.x", SCREW_READY)


@pytest.mark.parametrize(
    ("active", "bounces_ms", "code", "words"),
    [
        ("high", None, "not-touched", "up to 15 mm"),
        ("high", [30], "probe-broken", "its input is not active"),
        ("low", None, "probe-input", "logic 1 only"),
    ],
)
def test_what_an_smc30_cannot_find_is_refused(active: str, bounces_ms: list[int] | None, code: str, words: str) -> None:
    async def main(bench: Bench) -> None:
        bench.virtual.act_on_controller("screw", lambda unit: unit.set_input(2, level=active == "low"))
        if bounces_ms is not None:
            bench.put_contact(
                2.5 * float(bench.virtual.fleet.axis("screw.x").scale), [each * NS_PER_MS for each in bounces_ms]
            )
        report = await bench.run(SCREW_PROBE)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == code and words in refused.text, refused

    run_bench(main, with_screw(active), "screw.x", SCREW_READY)


def test_a_contact_of_a_corrected_axis_is_a_position_of_the_axis() -> None:
    """The table has 0.2 mm of error at the contact, whose motor position is known by truth."""
    points = [[-20, -0.4], [0, 0], [20, 0.4], [420, 0.4]]
    fleet = changed(with_touch(), gantry={"axes": {"x": {"correction": {"points": points, "max_slope": "5%"}}}})

    async def main(bench: Bench) -> None:
        axis = bench.virtual.fleet.axis("gantry.x")
        begun_counts = bench.virtual.controllers["gantry"].position("X")
        bench.put_contact(2_500)
        probed = await bench.probe()
        truth = axis.to_unit(begun_counts + 2_500)
        assert probed.least is not None and probed.most is not None and probed.motor is not None
        assert probed.least <= truth <= probed.most
        assert abs(float(probed.motor) - truth) <= probed.most - probed.least
        assert abs(truth - (begun_counts + 2_500) / 1000) > 0.2

    run_bench(main, fleet)


def test_an_axis_with_play_is_refused_by_name() -> None:
    fleet = changed(with_touch(), gantry={"axes": {"x": {"backlash": {"amount": 0.02}}}})

    async def main(bench: Bench) -> None:
        with pytest.raises(Refusal, match="has `backlash`, and which part of its play is taken up at the contact"):
            await bench.run(PROBE)

    run_bench(main, fleet)


def test_a_probe_of_a_rotary_axis_takes_the_shorter_way() -> None:
    rotary = {"kind": "rotary", "unit": "deg", "wrap": 360, "shortest_way": True, "soft_limits": None}
    fleet = changed(with_touch(), gantry={"axes": {"x": rotary}})

    async def main(bench: Bench) -> None:
        begun_counts = bench.find_rest()
        # Behind the first one no exact target of the axis is known.
        for target in (12, 350):
            step = f"{{do: probe, to: {{gantry.x: {target}}}, until: gantry.touch, speed: 10 deg/s, else: continue}}"
            report = await bench.run(step)
            assert report.state == "done", report.reason
        assert bench.find_rest() - begun_counts == pytest.approx(-20_000, abs=2)

    run_bench(main, fleet)
