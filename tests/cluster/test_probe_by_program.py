"""Probes by the resident program of an SMC-4000, against the truth of simulated contacts."""

import pytest
from cluster.test_probe import PROBE, Bench, run_bench, with_touch
from cluster.worlds import origin_host_ns

from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.report import ProbeReport

SHORTEST_US = 3000  # of a contact: an optocoupler may take half of it, and inputs are tested at samples


def check_contact(bench: Bench, probed: ProbeReport) -> None:
    """The report of a probe that began at 10 mm, against the truth."""
    assert bench.contact is not None
    (made, *_) = bench.contact.made
    true_mm = 10 + (made.counts - bench.start) / 1000
    assert probed.touched and probed.least <= true_mm <= probed.most
    assert probed.seen is not None
    made_ns = made.at_ns - origin_host_ns(bench.virtual)
    assert probed.seen.earliest_ns <= made_ns <= probed.seen.latest_ns
    true_overtravel = abs(bench.find_rest() - made.counts) / 1000
    assert 0 < true_overtravel <= probed.overtravel <= probed.stated


@pytest.mark.parametrize(
    ("number", "active", "bounces_ms"), [(5, "low", ()), (5, "high", (3, 2, 3, 1)), (2, "low", (20, 40))]
)
def test_any_input_stops_an_axis_within_what_was_stated(number: int, active: str, bounces_ms: tuple[int, ...]) -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(2500, [each * NS_PER_MS for each in bounces_ms])
        probed = await bench.probe()
        check_contact(bench, probed)
        assert probed.most - probed.least <= 0.010 and probed.stated < 0.03
        moved = await bench.run("{do: move, to: {gantry.x: 20}}")
        assert moved.state == "done", moved.reason

    run_bench(main, with_touch(active, number))


@pytest.mark.parametrize("speed", ["0.2 mm/s", "5 mm/s", "50 mm/s"])
def test_other_speeds_and_the_negative_direction(speed: str) -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(-2500)
        check_contact(bench, await bench.probe(PROBE.replace("15", "5").replace("1 mm/s", speed)))

    run_bench(main, with_touch("low", 5))


@pytest.mark.parametrize("number", [1, 5])
def test_an_input_that_becomes_passive_stops_an_axis(number: int) -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(-2500)  # made at 7.5 mm and below
        await bench.run("{do: move, to: {gantry.x: 5}}")
        probed = await bench.probe(PROBE.replace("speed", "level: passive, speed"))
        assert probed.touched and probed.least <= 7.5 <= probed.most
        assert 0 < (bench.find_rest() - bench.start) / 1000 + 2.5 <= probed.stated

    run_bench(main, with_touch("low", number))


def test_a_contact_that_is_lost_again_while_the_axis_brakes_is_one() -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(2500, [SHORTEST_US * 1000])
        probed = await bench.probe()
        assert probed.touched and probed.released

    run_bench(main, with_touch("low", 5))


def test_a_contact_at_the_beginning_is_one() -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(1)
        check_contact(bench, await bench.probe())

    run_bench(main, with_touch("low", 5))


def test_a_probe_that_touches_nothing_goes_to_its_end() -> None:
    async def main(bench: Bench) -> None:
        report = await bench.run(PROBE)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == "not-touched" and bench.find_rest() - bench.start == 5000
        probed = await bench.probe(PROBE.replace("15", "10").replace("speed", "else: continue, speed"))
        assert not probed.touched and probed.rest == 10

    run_bench(main, with_touch("low", 5))


@pytest.mark.parametrize(
    ("step", "number", "code", "words"),
    [
        (PROBE.replace("15", "399.99"), 5, "soft-limit", "a contact there ends it at 400.00"),
    ],
)
def test_what_the_program_cannot_do_is_refused(step: str, number: int, code: str, words: str) -> None:
    async def main(bench: Bench) -> None:
        report = await bench.run(step)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == code and words in refused.text, refused
        assert bench.find_rest() == bench.start

    run_bench(main, with_touch("low", number))


def test_an_input_that_is_active_before_the_start_is_refused() -> None:
    async def main(bench: Bench) -> None:
        bench.put_contact(0)
        report = await bench.run(PROBE)
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == "line-level" and "active already" in refused.text
        assert bench.find_rest() == bench.start

    run_bench(main, with_touch("low", 5))
