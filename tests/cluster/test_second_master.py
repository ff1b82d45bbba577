"""Another client sets the position of an axis between the release of its step and its end: the step does not begin, or
is stopped as soon as a reading shows it, and the axis has to be homed again."""

import asyncio
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import pytest
from cluster.worlds import EXAMPLES, job, outcome, run_fleet

from adapters.controller.slots.follower import StepFollower
from adapters.controller.state.armed_step import ArmedStep
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet
from orchestrator.model.report import JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet

SLOW_MEMBERS = ("feeder", "outlet")
"""A chain, whose members need more than a second from the release to T0."""


@dataclass(frozen=True)
class OtherClient:
    """axis: that the step moves. command: sets its position to 50000 counts."""

    axis: str
    command: str

    @property
    def controller(self) -> str:
        return self.axis.partition(".")[0]


CLIENTS = {
    "smc4000": OtherClient("gantry.x", "DPX=50000"),
    "ppsmc": OtherClient("table.turn", "pos1:50000"),
}
SHORTLY_NS = 10 * NS_PER_MS


class ReleaseSpy:
    """The T0 of the next step that a controller is released for, host time."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self._controller = ""
        self.t0_ns: asyncio.Future[int]
        release_present = StepFollower.release_present

        async def release_and_note(follower: StepFollower, released: ArmedStep, *terms: int) -> None:
            await release_present(follower, released, *terms)
            if follower._context.controller == self._controller and not self.t0_ns.done():
                self.t0_ns.set_result(released.t0_host_ns)

        monkeypatch.setattr(StepFollower, "release_present", release_and_note)

    def expect_release(self, controller: str) -> None:
        self._controller = controller
        self.t0_ns = asyncio.get_running_loop().create_future()


def _take_controllers(names: Sequence[str]) -> Fleet:
    plain = load_fleet(EXAMPLES / "all.fleet.yaml").to_plain()
    controllers: dict[str, Any] = {name: plain["controllers"][name] for name in names}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "one", "controllers": controllers})


async def _set_position(fleet: VirtualFleet, other: OtherClient) -> None:
    link = await fleet.wires[other.controller].open_link()
    link.write(other.command.encode() + b"\r")


async def _run_disturbed(
    fleet: VirtualFleet, spy: ReleaseSpy, other: OtherClient, steps: str, before_t0_ns: int | None = None
) -> JobReport:
    """Run a job, and set the position after the release of its step: at once, or that long before T0."""
    client = fleet.make_client("anna")
    names = ", ".join(fleet.fleet.controllers)
    ready = await outcome(fleet, job(f"[{{do: enable, axes: [{names}]}}, {{do: home, axes: [{names}]}}]"))
    assert ready.state == "done"
    await sleep_ns(fleet.clock, NS_PER_S)
    spy.expect_release(other.controller)
    job_id = await client.submit(job(steps))
    t0_ns = await spy.t0_ns
    if before_t0_ns is not None:
        await sleep_until_ns(fleet.clock, t0_ns - before_t0_ns)
    await _set_position(fleet, other)
    return await client.wait_for_job(job_id)


def _count_motions(fleet: VirtualFleet) -> int:
    return sum(len(unit.commanded_motions) for unit in fleet.controllers.values())


async def _find_unreferenced(fleet: VirtualFleet) -> set[str]:
    states = await fleet.make_client("ben").status()
    return {f"{name}.{axis}" for name, state in states.items() for axis, it in state.axes.items() if not it.referenced}


@pytest.mark.parametrize("make", CLIENTS)
def test_a_step_does_not_begin_when_a_reading_before_its_start_shows_another_position(
    make: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    other, spy = CLIENTS[make], ReleaseSpy(monkeypatch)
    steps = f"[{{do: move, by: {{{other.axis}: 5, feeder.x: 5}}, max_start_skew: 50 ms}}]"

    async def main(fleet: VirtualFleet) -> None:
        report = await _run_disturbed(fleet, spy, other, steps)
        assert report.state == "failed" and "and the step begins at 0: another client has set it" in report.reason
        t0_ns = spy.t0_ns.result()
        assert fleet.clock.now_ns() < t0_ns
        assert await _find_unreferenced(fleet) == {other.axis}
        motions = _count_motions(fleet)
        await sleep_until_ns(fleet.clock, t0_ns + NS_PER_S)
        assert _count_motions(fleet) == motions

    run_fleet(main, _take_controllers([other.controller, *SLOW_MEMBERS]))


@pytest.mark.parametrize("make", CLIENTS)
def test_a_step_is_stopped_when_its_first_reading_shows_another_position(
    make: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """No controller is read just before T0."""
    other, spy = CLIENTS[make], ReleaseSpy(monkeypatch)

    async def main(fleet: VirtualFleet) -> None:
        report = await _run_disturbed(fleet, spy, other, f"[{{do: move, by: {{{other.axis}: 5}}}}]", SHORTLY_NS)
        assert report.state == "failed" and "and the step moves it from 0 to 5: another client" in report.reason
        assert await _find_unreferenced(fleet) == {other.axis}
        motion = fleet.controllers[other.controller].commanded_motions[-1]
        assert motion.start_counts == 50_000 and motion.end_counts is not None
        assert motion.end_counts > 45_000  # it was on its way to 5000

    run_fleet(main, _take_controllers([other.controller]))


def test_a_step_fails_when_only_its_end_shows_another_position(monkeypatch: pytest.MonkeyPatch) -> None:
    """The axis turns back, and was not read where that would have shown it."""
    other, spy = OtherClient("gantry.x", "DPX=20"), ReleaseSpy(monkeypatch)
    pieces = "[{piece: line, to: [10, 5]}, {piece: line, to: [0, 0]}]"
    way = f"start: [0, 0], speed: 20 mm/s, tolerance: 1 mm, pieces: {pieces}"
    steps = f"[{{do: path, axes: [gantry.x, gantry.y], {way}}}]"

    async def main(fleet: VirtualFleet) -> None:
        report = await _run_disturbed(fleet, spy, other, steps, SHORTLY_NS)
        assert report.state == "failed"
        assert "axis x is at 20 counts, not at 0; it must be homed again" in report.reason
        assert await _find_unreferenced(fleet) == {other.axis}

    run_fleet(main, _take_controllers(["gantry"]))


def test_an_axis_beside_the_step_loses_its_reference_and_the_step_goes_on(monkeypatch: pytest.MonkeyPatch) -> None:
    other, spy = OtherClient("gantry.y", "DPY=50000"), ReleaseSpy(monkeypatch)

    async def main(fleet: VirtualFleet) -> None:
        report = await _run_disturbed(fleet, spy, other, "[{do: move, by: {gantry.x: 5}}]", SHORTLY_NS)
        assert report.state == "done"
        assert await _find_unreferenced(fleet) == {"gantry.y"}

    run_fleet(main, _take_controllers(["gantry"]))
