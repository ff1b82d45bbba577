"""Probes of several axes on a line by the resident program of an SMC-4000, against the truth of simulated contacts."""

import asyncio
from collections.abc import Awaitable, Callable, Sequence
from pathlib import Path

import pytest
from cluster.test_probe import Bench, run_bench, with_touch
from cluster.test_probe_by_program import SHORTEST_US
from cluster.test_probing_programs import load_program
from cluster.worlds import job, origin_host_ns

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.report import ProbeReport
from sim.core.contact import ContactPlace, PhysicalContact

BACK = (
    "{do: probe, to: {gantry.x: 10, gantry.y: 10}, until: gantry.touch, else: continue, "
    "speed: {gantry.x: 20 mm/s, gantry.y: 80 mm/s}}"
)
READY = "{do: enable, axes: [gantry]}, {do: home, axes: [gantry]}, {do: move, to: {gantry.x: 10, gantry.y: 10}}"
LINE = "{do: probe, name: EDGE, to: {gantry.x: 13, gantry.y: 14}, until: gantry.touch, speed: 1 mm/s}"


class LineBench:
    """A bench whose x and y stand at 10 mm. starts: where, physical counts."""

    def __init__(self, bench: Bench) -> None:
        self.bench = bench
        self.unit = bench.virtual.controllers["gantry"]
        self.starts = self.find_positions()

    def find_positions(self) -> dict[str, float]:
        """Where x and y are by truth, physical counts."""
        return {motor: self.unit.physical_position(motor) for motor in "XY"}

    def put_contact(self, distance: float, motor: str = "X", bounces_ns: Sequence[int] = ()) -> None:
        """Put a contact so many counts from where a motor stands now."""
        (point,) = self.bench.virtual.fleet.controllers["gantry"].inputs.values()
        level, process = point.active == "high", self.bench.virtual.simulators["gantry"]
        side = 1 if distance >= 0 else -1
        place = ContactPlace(
            motor,
            self.unit.physical_position(motor) + distance,
            side,
            point.number,
            level=level,
            bounces_ns=bounces_ns,
            beside="XY",
        )
        clock = self.bench.virtual.clock
        self.bench.contact = process.run_inside(lambda: PhysicalContact(self.unit, clock, place))

    def check(self, probed: ProbeReport, slope: float) -> None:
        """Check a report against the truth. slope: of y by x."""
        contact, rest = self.bench.contact, self.find_positions()
        assert contact is not None and probed.touched and probed.seen is not None
        made = contact.made[0]
        made_ns = made.at_ns - origin_host_ns(self.bench.virtual)
        assert probed.seen.earliest_ns <= made_ns <= probed.seen.latest_ns
        for motor, report in zip("XY", (probed, *probed.others), strict=True):
            true_mm = 10 + (made.beside[motor] - self.starts[motor]) / 1000
            assert report.least <= true_mm <= report.most
            true_overtravel = abs(rest[motor] - made.beside[motor]) / 1000
            assert true_overtravel <= report.overtravel <= report.stated
        assert self.find_off_line(slope) <= 2

    def find_off_line(self, slope: float) -> float:
        """How far y is off the line now by truth, counts."""
        ways = {motor: counts - self.starts[motor] for motor, counts in self.find_positions().items()}
        return abs(ways["Y"] - slope * ways["X"]) if slope <= 1 else abs(ways["X"] - ways["Y"] / slope)

    async def watch(self, slope: float) -> float:
        """How far y is off the line at most, counts, until both axes are at rest."""
        most, clock = 0.0, self.bench.virtual.clock
        while not self.unit.is_moving("X"):
            await sleep_ns(clock, NS_PER_MS)
        while self.unit.is_moving("X") or self.unit.is_moving("Y"):
            most = max(most, self.find_off_line(slope))
            await sleep_ns(clock, 10 * NS_PER_MS)
        return most


def run_line(main: Callable[[LineBench], Awaitable[None]], number: int = 5, active: str = "low") -> None:
    async def within(bench: Bench) -> None:
        await main(LineBench(bench))

    run_bench(within, with_touch(active, number), ready=READY)


@pytest.mark.parametrize(
    ("to", "slope", "motor", "speed"),
    [
        ((13.0, 14.0), 4 / 3, "X", "2 mm/s"),
        ((7.0, 6.0), 4 / 3, "Y", "20 mm/s"),
        ((15.0, 10.005), 0.001, "X", "5 mm/s"),
        ((9.995, 5.0), 1000.0, "Y", "5 mm/s"),
    ],
)
def test_a_contact_stops_all_axes_of_a_line_on_it(
    to: tuple[float, float], slope: float, motor: str, speed: str
) -> None:
    async def main(line: LineBench) -> None:
        index = "XY".index(motor)
        line.put_contact(200 * (to[index] - 10), motor)
        step = LINE.replace("13", f"{to[0]}").replace("14", f"{to[1]}").replace("1 mm/s", speed)
        watching = asyncio.ensure_future(line.watch(slope))
        line.check(await line.bench.probe(step), slope)
        assert await watching <= 2 + 5 * float(speed.split()[0])  # 5 ms at the speed, and two counts

    run_line(main)


@pytest.mark.parametrize(("number", "active", "bounces_ms"), [(2, "low", ()), (5, "high", (3, 2, 3, 1))])
def test_any_input_stops_a_line_and_a_bounce_counts_from_its_first_edge(
    number: int, active: str, bounces_ms: Sequence[int]
) -> None:
    async def main(line: LineBench) -> None:
        line.put_contact(300, bounces_ns=[each * NS_PER_MS for each in bounces_ms])
        probed = await line.bench.probe(LINE)
        line.check(probed, 4 / 3)
        assert all(one.most - one.least <= 0.010 for one in (probed, *probed.others))
        # Axes move alone again, and to where they were.
        target = "{do: move, to: {gantry.x: {of: EDGE.x}, gantry.y: {of: EDGE.y, plus: -1 mm}}}"
        report = await line.bench.run("{do: move, to: {gantry.x: 10, gantry.y: 10}}", LINE, target)
        assert report.state == "done", report.reason
        assert line.bench.contact is not None
        made, rest = line.bench.contact.made[-1], line.find_positions()
        assert rest["X"] == pytest.approx(made.beside["X"], abs=8)
        assert rest["Y"] == pytest.approx(made.beside["Y"] - 1000, abs=8)

    run_line(main, number, active)


def test_a_contact_of_a_line_that_is_lost_again_while_it_brakes_is_one() -> None:
    async def main(line: LineBench) -> None:
        line.put_contact(300, bounces_ns=[SHORTEST_US * 1000])
        probed = await line.bench.probe(LINE)
        assert probed.touched and probed.released

    run_line(main)


def test_a_line_that_touches_nothing_goes_to_its_end() -> None:
    async def main(line: LineBench) -> None:
        report = await line.bench.run(LINE.replace("1 mm/s", "20 mm/s"))
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == "not-touched"
        assert "up to 13 mm of gantry.x and 14 mm of gantry.y" in refused.text
        probed = await line.bench.probe(BACK)
        assert not probed.touched and (probed.rest, probed.others[0].rest) == (10, 10)

    run_line(main)


def test_of_an_axis_of_a_line_that_stands_the_contact_is_its_position() -> None:
    async def main(line: LineBench) -> None:
        line.put_contact(1500, "Y")
        probed = await line.bench.probe(LINE.replace("13", "10").replace("1 mm/s", "5 mm/s"))
        (y,) = probed.others
        assert probed.least <= 10 <= probed.most and probed.most - probed.least <= 0.002
        assert y.least <= 11.5 <= y.most

    run_line(main)


def test_what_a_line_cannot_do_is_refused() -> None:
    async def main(line: LineBench) -> None:
        line.put_contact(0)
        for step, code, words in (
            (LINE, "line-level", "input touch is active already"),
            (LINE.replace("14", "299.999"), "soft-limit", "axis y: the probe ends at 299.999"),
            (LINE.replace("1 mm/s", "400 mm/s"), "velocity-limit", "gantry.x would move at 240 mm/s; its limit is"),
        ):
            report = await line.bench.run(step)
            refused = report.steps[-1].refused
            assert refused is not None and refused.code == code and words in refused.text, refused
        assert line.find_positions() == line.starts

    run_line(main)


@pytest.mark.parametrize(
    ("fields", "words"),
    [
        ("to: {gantry.x: 3, lift.z: 4}, until: gantry.touch", "let the coordinator stop it, which is later"),
        ("to: {gantry.x: 3, gantry.y: 4}, until: gantry.x.forward", "a limit switch stops its own axis"),
        ("to: {gantry.x: 3}, until: lift.touch", "lift.touch cannot stop gantry.x, which is of another controller"),
        ("to: {}, until: gantry.touch", "`to` names no axis"),
    ],
)
def test_lines_that_nothing_stops_are_no_valid_job(fields: str, words: str) -> None:
    with pytest.raises(ValueError, match=words):
        job(f"[{{do: probe, {fields}, speed: 1 mm/s}}]")


@pytest.mark.parametrize("how", ["stop", "estop", "cut", "kill-coordinator"])
def test_a_fault_leaves_no_line_in_motion_behind_its_contact(how: str) -> None:
    async def main(line: LineBench) -> None:
        virtual = line.bench.virtual
        line.put_contact(400)
        await line.bench.client.submit(job(f"[{LINE}]"))
        await sleep_ns(virtual.clock, 450 * NS_PER_MS)
        assert line.unit.is_moving("X") and line.unit.is_moving("Y")
        if how == "stop":
            await line.bench.client.stop()
        elif how == "estop":
            await line.bench.client.estop("a test")
        elif how == "cut":
            virtual.wires["gantry"].cut = True
        else:
            virtual.kill("coordinator/first")
        await sleep_ns(virtual.clock, 2 * NS_PER_S)
        contact = line.bench.contact
        assert contact is not None and not line.unit.is_moving("X")
        assert line.find_off_line(4 / 3) <= 2
        for motor in "XY":
            made = contact.made[0].beside[motor] if contact.made else line.starts[motor] + 600
            assert line.find_positions()[motor] - made <= 20

    run_line(main)


def test_a_program_probes_on_a_line_and_goes_on_from_the_contact(tmp_path: Path) -> None:
    text = "G91\nG38.2 Y0.4 Z0.3 F60\nG92 Y0 Z0\nG90 G1 Y-1 Z-1 F600\nG0 Z-2\n"
    program = load_program(tmp_path, text, start="[10, 10]")

    async def main(line: LineBench) -> None:
        line.put_contact(150)
        forecast = await line.bench.client.dry_run(program)
        assert not forecast.problems, forecast.problems
        notes = [note for step in forecast.steps for note in step.conditions]
        line_note = "gantry.y goes on by at most 0.0164 mm behind the contact, and is off its line by at most 0.006 mm"
        assert line_note in notes and "gantry.x goes to line 2.gantry.x, between 10 and 10.3 mm" in notes
        report = await line.bench.client.run(program)
        (probed,) = [step.probe for step in report.steps if step.probe is not None]
        assert len(probed.others) == 1 and line.bench.contact is not None
        made, rest = line.bench.contact.made[0], line.find_positions()
        assert rest["X"] == pytest.approx(made.beside["X"] - 2000, abs=8)
        assert rest["Y"] == pytest.approx(made.beside["Y"] - 1000, abs=8)

    run_line(main)
