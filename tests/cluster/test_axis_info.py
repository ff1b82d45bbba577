"""What a program gets to know of an axis."""

import logging

import pytest
from cluster.worlds import PREPARE, demo_fleet, job, outcome, run_fleet

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.operation.axis_info import describe_axis
from orchestrator.runtime.virtual.fleet import VirtualFleet


def test_an_axis_is_described_from_the_fleet_file_with_its_offset() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        info, config = await client.axis("gantry.x"), fleet.fleet.axis("gantry.x")
        assert config.soft_limits is not None
        assert (info.name, info.make, info.motor, info.unit) == ("gantry.x", "smc4000", "X", config.unit)
        assert info.si_size == 1e-3
        assert info.resolution == float(1 / config.scale) and 10**-info.digits <= info.resolution
        assert (info.least, info.most) == (float(config.soft_limits.min), float(config.soft_limits.max))
        assert (info.velocity, info.acceleration) == (config.limits.velocity, config.limits.acceleration)
        assert info.referenced
        assert info.retarget.way == "extend" and info.retarget.within_s > 0
        position = await client.position("gantry.x")
        await outcome(fleet, job(f"[{{do: set-position, axes: {{gantry.x: {position + 10}}}}}]"))
        moved = await client.axis("gantry.x")
        assert moved.least == pytest.approx(float(config.soft_limits.min) + 10)
        assert moved.most == pytest.approx(float(config.soft_limits.max) + 10)

    run_fleet(main)


def test_an_axis_that_turns_has_no_limits() -> None:
    async def main(fleet: VirtualFleet) -> None:
        axis_now = (await fleet.make_client().axes())["gantry.x"]
        controller = await fleet.make_client().controller_info("gantry")
        turning = fleet.fleet.axis("gantry.x").model_copy(update={"kind": "rotary", "wrap": 360})
        info = describe_axis("gantry.x", turning, axis_now, controller)
        assert info.wrap == 360.0 and info.least is None and info.most is None

    run_fleet(main)


@pytest.mark.parametrize("name", ["gantry.xx", "gantry", "", "other.x", "gantry.x.y"])
def test_an_unknown_axis_is_refused_with_those_that_are(name: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        with pytest.raises(Refusal) as caught:
            await fleet.make_client().axis(name)
        assert caught.value.code == "unknown-axis" and "gantry.x" in caught.value.text and caught.value.remedy

    run_fleet(main)


def test_a_library_logs_and_prints_nothing(capfd: pytest.CaptureFixture[str], caplog: pytest.LogCaptureFixture) -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        capfd.readouterr()
        with caplog.at_level(logging.DEBUG):
            await client.axis("gantry.x")
            await client.axes()
            with pytest.raises(Refusal):
                await client.axis("no.axis")
        assert not caplog.records and capfd.readouterr() == ("", "")

    run_fleet(main)


def test_a_description_is_what_the_fleet_file_says_and_changes_no_digest() -> None:
    plain = demo_fleet().to_plain()
    plain["controllers"]["gantry"]["axes"]["x"]["description"] = "Along the rail, towards the door"
    described = Fleet.model_validate(plain)
    assert described.controllers["gantry"].digest == demo_fleet().controllers["gantry"].digest

    async def main(fleet: VirtualFleet) -> None:
        assert (await fleet.make_client().axis("gantry.x")).description == "Along the rail, towards the door"

    run_fleet(main, described)
