"""Probes to limit switches of an SMC-4000, against the truth of simulated ones."""

import pytest
from cluster.test_probe import READY, STAGE_READY, Bench, run_bench
from cluster.worlds import job

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from sim.yaskawa.machine.controller import YaskawaController

FORWARD, REVERSE = 12_500, 7_500  # counts behind the reference, where the switches are
PROBE = "{do: probe, name: END, to: {gantry.x: 15}, until: gantry.x.forward, speed: 1 mm/s}"
BACK = "{do: probe, to: {gantry.x: 5}, until: gantry.x.reverse, speed: 1 mm/s}"


def press_at(bench: Bench, forward: int, reverse: int) -> None:
    """Put the switches, counts of the reference."""
    unit, zero = bench.virtual.controllers["gantry"], round(bench.start) - 10_000
    assert isinstance(unit, YaskawaController)
    unit.machine.environment.travel["X"] = (zero + reverse, zero + forward)


@pytest.mark.parametrize("speed", ["0.2 mm/s", "1 mm/s", "20 mm/s"])
@pytest.mark.parametrize("forward", [True, False])
def test_a_limit_switch_stops_its_axis_within_what_was_stated(forward: bool, speed: str) -> None:
    async def main(bench: Bench) -> None:
        press_at(bench, FORWARD, REVERSE)
        step, true_mm, side = (PROBE, 12.5, 1) if forward else (BACK, 7.5, -1)
        probed = await bench.probe(step.replace("1 mm/s", speed))
        assert probed.touched and probed.least <= true_mm <= probed.most
        true_overtravel = side * ((bench.find_rest() - bench.start) / 1000 + 10 - true_mm)
        assert 0 <= true_overtravel <= probed.overtravel <= probed.stated and not probed.released
        # It leaves its switch, and goes to what was measured.
        moved = await bench.run("{do: move, to: {gantry.x: 10}}")
        assert moved.state == "done", moved.reason

    run_bench(main)


def test_a_later_step_uses_the_place_of_a_limit_switch() -> None:
    async def main(bench: Bench) -> None:
        press_at(bench, FORWARD, REVERSE)
        report = await bench.run(PROBE, "{do: move, to: {gantry.x: {of: END.x, plus: -1 mm}}}")
        assert report.state == "done", report.reason
        assert bench.find_rest() - bench.start == pytest.approx(1500, abs=10)

    run_bench(main)


@pytest.mark.parametrize(
    ("step", "code", "words"),
    [
        (PROBE, "not-touched", "gantry.x.forward has not become active up to 15 mm"),
        (PROBE.replace("15", "5"), "probe-input", "axis x moves away from its forward limit switch"),
        ("{do: probe, to: {stage.u: 15}, until: stage.u.forward, speed: 1 mm/s}", "no-probe", "the make shrc203"),
    ],
)
def test_what_a_limit_probe_cannot_do_is_refused(step: str, code: str, words: str) -> None:
    async def main(bench: Bench) -> None:
        report = await bench.run(step)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == code and words in refused.text, refused

    run_bench(main, ready=f"{READY}, {STAGE_READY}")


def test_an_axis_on_its_switch_is_refused() -> None:
    async def main(bench: Bench) -> None:
        press_at(bench, 9_000, REVERSE)
        report = await bench.run(PROBE)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == "limit-switch" and bench.find_rest() == bench.start

    run_bench(main)


@pytest.mark.parametrize(
    ("step", "words"),
    [
        (PROBE.replace("x.forward", "y.forward"), "gantry.y.forward is no limit switch of gantry.x"),
        (PROBE.replace("x.forward", "x.up"), "gantry.x.up is no limit switch of gantry.x"),
        (PROBE.replace("speed", "level: passive, speed"), "a limit switch stops gantry.x by its controller"),
        (PROBE.replace("speed", "by: host, speed"), "a limit switch stops gantry.x by its controller"),
    ],
)
def test_a_limit_that_is_none_is_refused_when_the_job_is_read(step: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        job(f"[{step}]")


@pytest.mark.parametrize("how", ["stop", "estop"])
def test_a_stop_ends_a_limit_probe(how: str) -> None:
    async def main(bench: Bench) -> None:
        submitted = await bench.client.submit(job(f"[{PROBE}]"))
        await sleep_ns(bench.virtual.clock, 2000 * NS_PER_MS)
        assert bench.virtual.controllers["gantry"].is_moving("X")
        await (bench.client.stop() if how == "stop" else bench.client.estop("a test"))
        await sleep_ns(bench.virtual.clock, 100 * NS_PER_MS)
        assert not bench.virtual.controllers["gantry"].is_moving("X")
        if how == "stop":
            assert (await submitted.result()).state in ("aborted", "failed", "cancelled")

    run_bench(main)


def test_a_dry_run_states_the_overtravel_and_the_range() -> None:
    async def main(bench: Bench) -> None:
        forecast = await bench.client.dry_run(job(f"[{PROBE}]"))
        assert not forecast.problems
        notes = forecast.steps[0].conditions
        assert any("gantry.x goes on by at most 0.01" in note for note in notes), notes
        wide = await bench.client.dry_run(job(f"[{PROBE.replace('15', '399.999')}]"))
        assert [problem.code for problem in wide.problems] == ["soft-limit"]

    run_bench(main)
