"""Curved virtual axes: a crystal's energy is reached, shown and limited; what its curve does not allow is refused."""

from typing import Any

import pytest
from cluster.worlds import job, outcome, run_fleet

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.simulated_fleets import make_smc4000
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
