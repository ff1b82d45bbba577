"""Curved virtual axes: a crystal's energy is reached, shown and limited; what its curve does not allow is refused."""

import asyncio
from typing import Any

import numpy as np
import pytest
from cluster.test_virtual_axes import SAMPLE_NS, read_truth, run_watched
from cluster.worlds import job, outcome, run_fleet

from orchestrator.clock.base import sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.simulated_fleets import make_cia402, make_shrc203, make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet

PREPARE = "{do: enable, axes: [mono]}, {do: home, axes: [mono]}, {do: move, to: {gonio.bragg: 10}}"
KEV_PER_COUNT = 2e-3  # near 11 keV, of 1000 counts a degree


def mono_fleet(**group: Any) -> Fleet:
    """An SMC-4000 with an axis that turns a Si(111) crystal, and the energy."""
    config = make_smc4000(1)
    config["axes"] = {"bragg": {**config["axes"]["x"], "unit": "deg", "soft_limits": {"min": -2, "max": 60}}}
    energy = {"unit": "keV", "soft_limits": {"min": 4, "max": 20}}
    mono = {"kind": "energy", "of": ["gonio.bragg"], "spacing": "0.3135602 nm", "axes": {"energy": energy}}
    plain = {
        "schema": "tutti.fleet/1",
        "fleet": "mono",
        "controllers": {"gonio": config},
        "virtual": {"mono": mono | group},
    }
    return Fleet.model_validate(plain | {"positions": {"edge": {"mono.energy": "8979 eV"}}})


def test_an_energy_is_reached_and_shown() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        state = (await client.virtual_states())["mono"]
        assert state.obstacle == "gonio.bragg is not referenced"
        assert state.axes == {}, "at 0 degrees it reflects nothing"
        steps = "{do: move, to: {mono.energy: 8}}, {do: move, to: edge}, {do: move, by: {mono.energy: -100 eV}}"
        report = await outcome(fleet, job(f"[{PREPARE}, {steps}]"))
        assert report.state == "done", report.reason
        assert await client.position("mono.energy") == pytest.approx(8.879, abs=KEV_PER_COUNT)
        (energy,) = fleet.fleet.virtual_axes.maps["mono"].observe([fleet.controllers["gonio"].position("X") / 1000])
        assert energy == pytest.approx(8.879, abs=KEV_PER_COUNT)
        axis = (await client.virtual_states())["mono"].axes["energy"]
        assert axis.low <= axis.position <= axis.high and axis.unit == "keV"

    run_fleet(main, mono_fleet())


@pytest.mark.parametrize(
    ("step", "text"),
    [
        ("{do: move, to: {mono.energy: 3}}", "beyond its soft limits 4 to 20 keV"),
        ("{do: move, to: {mono.energy: 8}, speed: 1 deg/s}", "it differs along a curve"),
        ("{do: move, to: {mono.energy: 8 mm}}", "mm is a unit of length"),
    ],
)
def test_what_a_curve_does_not_allow_is_refused(step: str, text: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        with pytest.raises(Refusal) as caught:
            await fleet.make_client().submit(job(f"[{PREPARE}, {step}]"))
        assert text in caught.value.text

    run_fleet(main, mono_fleet())


def test_energies_that_no_angle_reflects_are_refused() -> None:
    async def main(fleet: VirtualFleet) -> None:
        with pytest.raises(Refusal, match="is not above 1977"):
            await fleet.make_client().submit(job(f"[{PREPARE}, {{do: move, to: {{mono.energy: 1.5}}}}]"))

    run_fleet(main, mono_fleet(axes={"energy": {"unit": "keV"}}).model_copy(update={"positions": {}}))


# Several real axes: on the way they follow the curve

CRYSTALS = "{do: enable, axes: [gonio, slide]}, {do: home, axes: [gonio, slide]}, {do: move, to: {gonio.bragg: 10}}"
READY = f"{CRYSTALS}, {{do: move, to: {{mono.exit: 20}}}}"
JERK = 20_000


def crystal_fleet(slide: dict[str, Any] | None = None) -> Fleet:
    """Two crystals: an SMC-4000 turns them, a CiA 402 drive moves them apart; their energy and the beam's exit."""
    config, slide = make_smc4000(1), slide or make_cia402(3)
    motor = config["axes"]["x"]
    limits = {"velocity": 20, "acceleration": 200, "jerk": JERK}
    bragg = {
        **motor,
        "homing": {"speed": 10},
        "unit": "deg",
        "scale": 10_000,
        "limits": limits,
        "soft_limits": {"min": -2, "max": 60},
    }
    gap = {**slide["axes"]["x"], "soft_limits": {"min": 0, "max": 40}}
    if slide["adapter"] == "cia402":
        gap["limits"] = {**gap["limits"], "jerk": JERK}
    config["axes"], slide["axes"] = {"bragg": bragg}, {"gap": gap}
    axes = {"energy": {"unit": "keV", "soft_limits": {"min": 4, "max": 20}}, "exit": {"unit": "mm"}}
    mono = {"kind": "energy", "of": ["gonio.bragg", "slide.gap"], "spacing": "0.3135602 nm", "axes": axes}
    controllers = {"gonio": config, "slide": slide}
    return Fleet.model_validate(
        {"schema": "tutti.fleet/1", "fleet": "mono", "controllers": controllers, "virtual": {"mono": mono}}
    )


def find_distances(seen: list[tuple[float, ...]]) -> tuple[float, float]:
    """How far energy and exit were from the line between their first and last position, at most."""
    points = np.array(seen)
    factors = np.array([KEV_PER_COUNT / 10, 0.002])  # about what a count moves them
    way, offsets = (points[-1] - points[0]) / factors, (points - points[0]) / factors
    shares = offsets @ way / (way @ way)
    energy, exit_mm = np.max(np.abs(offsets - shares[:, None] * way) * factors, axis=0).tolist()
    return energy, exit_mm


@pytest.mark.parametrize(
    "move",
    [
        pytest.param("to: {mono.energy: 8}", marks=pytest.mark.nightly),
        "to: {mono.energy: 8, mono.exit: 24}, speed: 0.2",
        pytest.param("by: {mono.exit: -4 mm}", marks=pytest.mark.nightly),
    ],
)
@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 69))])
def test_a_curved_group_follows_its_curve_within_the_bound(move: str, seed: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, job(f"[{READY}]"))).state == "done"
        await asyncio.sleep(20)  # until the clocks are known well
        report, seen = await run_watched(fleet, f"{{do: move, {move}}}", "mono")
        assert report.state == "done", report.reason
        (step,) = report.steps
        assert step.do == "move" and step.path is None
        energy, exit_mm = find_distances(seen)
        assert energy <= step.virtual["mono.energy"].most and exit_mm <= step.virtual["mono.exit"].most
        state = (await fleet.make_client().virtual_states())["mono"]
        ends = (
            {"energy": 8.0, "exit": 24.0} if "24" in move else {"energy": 8.0} if "energy" in move else {"exit": 16.0}
        )
        for name, value in ends.items():
            assert state.axes[name].position == pytest.approx(value, abs=2e-3)

    run_fleet(main, crystal_fleet(), seed)


def test_its_bound_is_that_of_the_path_in_real_axes_and_the_error_of_the_curve() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, job(f"[{READY}]"))).state == "done"
        await asyncio.sleep(20)
        dry_run = await fleet.make_client().dry_run(job("[{do: move, to: {mono.energy: 8}}]"))
        (planned,) = dry_run.steps
        assert planned.path is not None and planned.path.bound is not None
        assert planned.path.unit == "counts"
        factors = [KEV_PER_COUNT / 10, 2e-3]  # at most what a count of the real axes moves energy and exit
        for (name, bound), factor in zip(planned.virtual.items(), factors, strict=True):
            counts = bound.most / factor
            assert counts <= 1.1 * planned.path.bound.predicted + 1, name
        assert planned.least_s == planned.most_s > 0.3

    run_fleet(main, crystal_fleet())


def test_a_move_to_where_it_stands_is_done() -> None:
    async def main(fleet: VirtualFleet) -> None:
        move = "{do: move, to: {mono.energy: 8, mono.exit: 20}}"
        report = await outcome(fleet, job(f"[{READY}, {move}, {move}]"))
        assert report.state == "done" and report.steps[-1].reason == "already there"

    run_fleet(main, crystal_fleet())


def test_a_pause_brakes_along_the_curve_and_it_is_followed_to_its_end() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, job(f"[{READY}]"))).state == "done"
        client = fleet.make_client()
        seen: list[tuple[float, ...]] = [tuple(map(float, read_truth(fleet, "mono")))]
        job_id = await client.submit(job("[{do: move, by: {mono.energy: -3}, speed: 0.2}]"))
        while abs(float(read_truth(fleet, "mono")[0]) - seen[0][0]) < 0.5:
            await sleep_ns(fleet.clock, SAMPLE_NS)
        await client.pause_job(job_id, now=True)
        for _ in range(400):
            await sleep_ns(fleet.clock, SAMPLE_NS)
            seen.append(tuple(map(float, read_truth(fleet, "mono"))))
        assert seen[-1] == seen[-2] and abs(seen[-1][0] - seen[0][0]) < 2.5
        await client.resume_job(job_id)
        report = await client.wait_for_job(job_id)
        assert report.state == "done", report.reason
        seen.append(tuple(map(float, read_truth(fleet, "mono"))))
        assert seen[-1][0] - seen[0][0] == pytest.approx(-3, abs=2e-3)
        energy, exit_mm = find_distances(seen)
        (step,) = report.steps
        assert energy <= step.virtual["mono.energy"].most and exit_mm <= step.virtual["mono.exit"].most

    run_fleet(main, crystal_fleet())


@pytest.mark.parametrize(
    ("step", "text"),
    [
        ("{do: move, to: {mono.energy: 8}, speed: 1 keV/s}", "it differs along a curve"),
        ("{do: move, to: {mono.energy: 8}, sync: none}", "elsewhere on the way"),
        ("{do: move, to: {mono.energy: 8, slide.gap: 3}}", "nothing else can be a part of"),
        ("{do: move, to: {mono.energy: 4.1, mono.exit: 79}}", "soft limit"),
        ("{do: move, to: {mono.energy: 1.5}}", "beyond its soft limits"),
    ],
)
def test_what_a_curve_of_several_axes_does_not_allow_is_refused(step: str, text: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        with pytest.raises(Refusal) as caught:
            await fleet.make_client().submit(job(f"[{READY}, {step}]"))
        assert text in caught.value.text, caught.value.text

    run_fleet(main, crystal_fleet())


def test_a_make_that_cannot_follow_a_curve_is_refused_by_name() -> None:
    async def main(fleet: VirtualFleet) -> None:
        report = await outcome(fleet, job(f"[{READY}, {{do: move, to: {{mono.energy: 8}}}}]"))
        refused = report.steps[-1].refused
        assert refused is not None and refused.code == "curved"
        assert "slide.gap cannot follow the curve" in refused.text

    run_fleet(main, crystal_fleet(make_shrc203(3)))
