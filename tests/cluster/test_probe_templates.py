"""The example templates that probe, against the truth of the work piece."""

from collections.abc import Awaitable, Callable
from dataclasses import dataclass, field
from math import hypot

import pytest
from cluster.worlds import EXAMPLES, job, run_fleet

from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.report import JobReport
from orchestrator.model.templates.template import load_job
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.controller import SimulatedController

READY = "[{do: enable, axes: [mill]}, {do: home}, {do: move, to: {mill.x: 50, mill.y: 40, mill.z: -10}}]"


@dataclass
class WorkPiece:
    """Switches inputs by the truth of all axes. find_distance: mm from the tip to the surface, from motor positions in
    mm; it touches below 0. numbers: of the inputs."""

    unit: SimulatedController
    clock: Clock
    find_distance: Callable[[float, float, float], float]
    numbers: tuple[int, ...]
    origin: dict[str, float] = field(default_factory=dict[str, float])
    is_free: bool | None = None

    def __post_init__(self) -> None:
        # Where the axes stand when it is put there, their motors are at 50, 40 and -10 mm.
        self.origin = {
            axis: self.unit.physical_position(axis) - 1000 * at for axis, at in zip("XYZ", (50, 40, -10), strict=True)
        }
        self._look()

    def find_place(self) -> tuple[float, float, float]:
        x, y, z = ((self.unit.physical_position(axis) - self.origin[axis]) / 1000 for axis in "XYZ")
        return x, y, z

    def _look(self) -> None:
        distance = self.find_distance(*self.find_place())
        if (distance > 0) != self.is_free:
            self.is_free = distance > 0
            for number in self.numbers:
                self.unit.set_input(number, level=self.is_free)
        speed = max(1.0, *(abs(self.unit.velocity(axis)) / 1000 for axis in "XYZ"))
        pause_ns = min(NS_PER_MS, max(20_000, round(abs(distance) / speed * NS_PER_S / 2)))
        self.clock.call_at_ns(self.clock.now_ns() + pause_ns, self._look)


@dataclass
class Mill:
    """The example fleet, ready. client: its operator."""

    virtual: VirtualFleet
    client: Tutti

    def put(self, find_distance: Callable[[float, float, float], float], *numbers: int) -> WorkPiece:
        unit = self.virtual.controllers["mill"]
        return self.virtual.simulators["mill"].run_inside(
            lambda: WorkPiece(unit, self.virtual.clock, find_distance, numbers)
        )

    async def run(self, template: str, **values: str) -> JobReport:
        """Run a template that the dry run has nothing against."""
        asked = load_job(EXAMPLES / f"{template}.template.job.yaml", values)
        forecast = await self.client.dry_run(asked)
        assert not forecast.problems, forecast.problems
        return await self.client.run(asked)

    async def find_zeros(self) -> dict[str, float]:
        """Where the user's zeros are, motor positions, mm."""
        axes = (await self.client.status())["mill"].axes
        return {name: axis.motor_position - axis.position for name, axis in axes.items()}


def run_mill(main: Callable[[Mill], Awaitable[None]]) -> None:
    fleet = load_fleet(EXAMPLES / "mill.fleet.yaml")

    async def prepare(virtual: VirtualFleet) -> None:
        client = virtual.make_client("operator")
        await client.run(job(READY))
        await main(Mill(virtual, client))

    run_fleet(prepare, fleet)


def test_the_zero_is_at_the_edge() -> None:
    async def main(mill: Mill) -> None:
        mill.put(lambda x, _, __: 53.3 - 1.5 - x, 1, 2)  # a tip of 3 mm
        report = await mill.run("edge", farthest="56 mm", radius="1.5 mm")
        assert report.state == "done"
        assert (await mill.find_zeros())["x"] == pytest.approx(53.3, abs=0.002)

    run_mill(main)


def test_a_tool_setter_gives_z_the_height_of_the_tip() -> None:
    async def main(mill: Mill) -> None:
        mill.put(lambda _, __, z: z + 12.7, 3)
        await mill.run("tool-length", lowest="-20 mm", height="50 mm")
        # The setter is at -12.7 mm of this tool, and 50 mm high.
        assert (await mill.find_zeros())["z"] == pytest.approx(-62.7, abs=0.002)

    run_mill(main)


@pytest.mark.parametrize("template", ["bore-centre", "boss-centre"])
def test_the_zero_is_in_the_centre(template: str) -> None:
    """The probe begins 0.8 mm and 0.6 mm beside it."""

    async def main(mill: Mill) -> None:
        if template == "bore-centre":
            mill.put(lambda x, y, _: 3 - hypot(x - 50.8, y - 39.4), 1, 2)
            values = {"way": "6 mm"}
        else:
            mill.put(lambda x, y, z: max(hypot(x - 50.8, y - 39.4) - 3, z + 11), 1, 2)
            values = {"beside": "5 mm", "depth": "3 mm"}
        await mill.run(template, **values)
        zeros = await mill.find_zeros()
        assert (zeros["x"], zeros["y"]) == (pytest.approx(50.8, abs=0.003), pytest.approx(39.4, abs=0.003))

    run_mill(main)
