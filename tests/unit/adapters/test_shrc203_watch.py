"""Settings of an SHRC-203 that its panel or another client changes are found, and written again."""

import pytest
from unit.adapters.test_shrc203_driver import Bench, run

from adapters.contract import SettingDifference
from adapters.shrc203.driver import ShrcDriver
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.errors import Refusal
from sim.shrc203.controller import Shrc203Controller

ROUND = 7
"""Calls of the check at rest within which every setting is compared."""


async def check_round(driver: ShrcDriver) -> list[SettingDifference]:
    return [each for _ in range(ROUND) for each in await driver.check_settings(everything=False)]


async def move(bench: Bench, target: int) -> None:
    await bench.start({"x": target})
    await bench.driver.slots.present.wait_for_start()
    assert (await bench.driver.slots.present.wait_for_end()).state == "done"


def test_a_controller_that_nothing_has_changed_has_no_differences() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        for target in (5000, 0):
            assert not await check_round(bench.driver)
            assert not await bench.driver.check_settings(everything=True)
            await move(bench, target)
        assert await bench.driver.home_axes(["x", "y"], lambda _: None) == {}
        assert not await check_round(bench.driver)

    run(case)


@pytest.mark.parametrize(
    ("command", "items", "at_arm", "moves_reference"),
    [
        (
            "S:2,20",
            {"division (?:S) of axis y", "nm per pulse (?:P) of axis y"},
            {"nm per pulse (?:P) of axis y"},
            True,
        ),
        ("F:30", {"loop mode (?:F) of axis z"}, {"loop mode (?:F) of axis z"}, False),
        ("W:5", {"settling wait (?:W)"}, set[str](), False),
        ("B:2S100F900R77", {"origin return speeds (?:B) of axis y"}, set[str](), False),
    ],
)
def test_a_changed_setting_is_found_and_written_again(
    command: str, items: set[str], at_arm: set[str], moves_reference: bool
) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert await bench.driver.send_raw(command) == "OK"
        found = await check_round(bench.driver)
        assert {each.item for each in found} == items
        assert {each.item for each in await bench.driver.check_settings(everything=True)} == at_arm
        assert {each.moves_reference for each in found} == {moves_reference}
        assert all(each.found != each.expected and each.to_fault().remedy for each in found)
        await bench.driver.clear_faults()
        assert not await check_round(bench.driver)
        assert not await bench.driver.check_settings(everything=True)
        await move(bench, 5000)
        assert bench.unit.position("1") == 5000

    run(case, simulate={"scales": True}, options={"loop": "open"})


def test_what_only_the_memory_switches_can_change_stays_a_fault() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert isinstance(bench.unit, Shrc203Controller)
        bench.unit.unit.axes[0].base_rate *= 2
        found = await bench.driver.check_settings(everything=True)
        assert [(each.item, each.repairable, each.moves_reference) for each in found] == [
            ("nm per pulse (?:P) of axis x", True, True)
        ]
        with pytest.raises(Refusal) as caught:
            await bench.driver.clear_faults()
        assert "memory switches" in caught.value.remedy

    run(case)


def test_the_check_costs_little_and_waits_for_no_completion() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        longest_ns = 0
        for everything in (True, *[False] * ROUND):
            began_ns = bench.clock.now_ns()
            await bench.driver.check_settings(everything=everything)
            longest_ns = max(longest_ns, bench.clock.now_ns() - began_ns)
        assert longest_ns < 40 * NS_PER_MS
        await bench.start({"x": 20_000})
        await bench.driver.slots.present.wait_for_start()
        assert not await bench.driver.check_settings(everything=True)
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case)
