"""Settings that another client changes, as far as both models behave alike: found, and repaired by a reset."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import pytest
from unit.adapters import test_smc2000_bench as smc2000
from unit.adapters import test_smc4000_bench as smc4000
from unit.adapters.settings_at_rest import find_at_rest
from unit.adapters.test_smc4000_bench import trapezoid


@dataclass(frozen=True)
class Model:
    """turns: checks at rest that cover every part. line, addition: of the program, as another client changes it."""

    run: Callable[[Any], object]
    turns: int
    gear: str
    line: int
    addition: str


MODELS = {
    "smc4000": Model(smc4000.run, 80, "GAY=X", 17, ";SPX=100"),
    "smc2000": Model(smc2000.run, 300, "GA X", 9, ";NO"),
}
BOTH = pytest.mark.parametrize("model", MODELS.values(), ids=MODELS)


@BOTH
def test_nothing_differs_after_connecting_and_after_the_adapters_own_changes(model: Model):
    async def main(world: Any) -> None:
        await world.ready()
        await world.driver.load_soft_limits({"x": (-5000, 60_000), "y": None})
        assert not await world.driver.check_settings(everything=True)
        await world.moved({"x": trapezoid(0, 40_000, 80_000, 700_000)})
        assert not await find_at_rest(world.driver, model.turns)
        await world.driver.load_soft_limits({"x": None})
        assert not await world.driver.check_settings(everything=True)
        assert not await find_at_rest(world.driver, model.turns)

    model.run(main)


@BOTH
def test_gearing_that_was_left_on_is_switched_off_when_connecting(model: Model):
    async def main(world: Any) -> None:
        await world.talk(model.gear)
        await world.talk("GRY=0.5")
        await world.ready()
        assert not await world.driver.check_settings(everything=True)
        assert (await world.moved({"x": trapezoid(0, 40_000, 80_000, 700_000)}))[2].state == "done"
        assert world.controller.position("Y") == 0

    model.run(main)


@BOTH
def test_a_contour_mode_that_another_client_has_entered_does_not_refuse_a_step(model: Model):
    async def main(world: Any) -> None:
        await world.ready()
        assert "?" not in await world.driver.send_raw("CM XY")
        assert not await world.driver.check_settings(everything=True)
        assert (await world.moved({"x": trapezoid(0, 4000, 20_000, 200_000)}))[2].state == "done"

    model.run(main)


@BOTH
def test_a_changed_program_is_found_at_rest_line_by_line_and_a_reset_loads_it_again(model: Model):
    async def main(world: Any) -> None:
        await world.ready(5)
        lines = world.controller.machine.program.lines
        lines[model.line] = lines[model.line] + model.addition
        (difference,) = (await find_at_rest(world.driver, model.turns)).values()
        assert difference.item == f"line {model.line} of the resident program"
        await world.driver.clear_faults()
        assert not await find_at_rest(world.driver, model.turns)
        assert (await world.moved({"x": trapezoid(0, 4000, 20_000, 200_000)}))[2].state == "done"

    model.run(main)


@BOTH
def test_a_limit_switch_shows_at_rest_on_every_axis(model: Model):
    async def main(world: Any) -> None:
        await world.ready(5)
        for axis, letter in (("x", "X"), ("y", "Y")):
            for side in ("forward", "reverse", "both", "none"):
                world.controller.set_limit(letter, side)
                assert (await world.driver.poll()).axes[axis].limit == side

    model.run(main)
