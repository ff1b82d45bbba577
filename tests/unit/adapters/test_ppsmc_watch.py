"""Settings of a pp-electronic SMC that its touch screen or another client changes are found, and written again."""

from typing import Any

import pytest
from unit.adapters.ppsmc_bench import Bench, controller, run
from unit.adapters.test_ppsmc_homing import SWITCHES

from adapters.contract import SettingDifference
from adapters.ppsmc.driver import PpSmcDriver
from adapters.ppsmc.unitstate import PpSmcReading, PpSmcState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import StartOptions, TriggerDrive

ROUND = 30
"""Calls of the check at rest within which every axis is compared, on a serial line too."""
SERIAL = {"answer_ms": 5000, "io_port": True}


async def check_round(driver: PpSmcDriver) -> list[SettingDifference]:
    return [each for _ in range(ROUND) for each in await driver.check_settings(everything=False)]


def config(serial: bool) -> Any:
    options = SERIAL if serial else {"io_port": True}
    return controller(serial=serial, options=options, outputs={"flag": {"number": 1}})


@pytest.mark.parametrize("serial", [False, True])
def test_a_controller_that_nothing_has_changed_has_no_differences(serial: bool) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        for target in (5000, 0):
            assert (await bench.move({"x": target, "y": -target})).state == "done"
            assert not await check_round(bench.driver)
            assert not await bench.driver.check_settings(everything=True)
        assert await bench.driver.home_axes(["z"], lambda _: None) == {}
        assert not await check_round(bench.driver)

    run(case, simulate=SWITCHES, config=config(serial))


@pytest.mark.parametrize("serial", [False, True])
@pytest.mark.parametrize(
    ("command", "setting", "moves_reference"),
    [
        ("gnum1:2000", "gnum1 (axis x)", True),
        ("gz2:500", "gnum2 (axis y)", True),
        ("mdir3:1", "mdir3 (axis z)", True),
        ("ecl1:1", "ecl1 (axis x)", False),
        ("emips2:7", "emips2 (axis y)", False),
        ("rofs1:2.5", "rofs1 (axis x)", False),
        ("dcpl3:1", "dcpl3 (axis z)", False),
    ],
)
def test_a_changed_setting_is_found_and_written_again(
    command: str, setting: str, moves_reference: bool, serial: bool
) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        assert (await bench.move({"x": 1000, "y": 1000, "z": 1000})).state == "done"
        await bench.send_as_other_client(command)
        if serial:
            # The lines of ?conf take long: arming compares those that it reads anyway.
            with pytest.raises(Refusal) as caught:
                await bench.arm({"x": 3000, "y": 3000, "z": 3000})
            assert caught.value.code in ("setting-changed", "other-start")
            await bench.driver.slots.unload()
        else:
            found = list(await bench.driver.check_settings(everything=True))
            assert [(each.item, each.moves_reference) for each in found] == [(setting, moves_reference)]
        assert {each.item for each in await check_round(bench.driver)} == {setting}
        await bench.driver.clear_faults()
        assert not await check_round(bench.driver)
        assert not await bench.driver.check_settings(everything=True)
        assert (await bench.move({"x": 3000, "y": 3000, "z": 3000})).state == "done"

    run(case, config=config(serial))


def test_a_program_is_not_armed_with_changed_settings() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.send_as_other_client("emips1:7")
        with pytest.raises(Refusal) as caught:
            await bench.arm({"x": 3000}, StartOptions(drive=TriggerDrive(output="flag", active_ns=50 * NS_PER_MS)))
        assert caught.value.code == "setting-changed" and "emips1" in caught.value.text

    run(case, config=config(serial=True))


def test_the_check_costs_little() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        for everything, most_ms in ((True, 200), (False, 130), (False, 130)):
            began_ns = bench.clock.now_ns()
            await bench.driver.check_settings(everything=everything)
            assert bench.clock.now_ns() - began_ns < most_ms * NS_PER_MS

    run(case)


def test_a_blocked_controller_is_not_compared() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.stop(abort=True)
        await sleep_ns(bench.clock, NS_PER_S)
        assert not await bench.driver.check_settings(everything=True)
        assert not await check_round(bench.driver)

    run(case)


@pytest.mark.parametrize("method", ["switch", "slowdown", "limit"])
def test_a_search_has_not_ended_before_it_is_seen_to_begin(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """What is read lags behind a start: the axis is at rest, and its reference that of the search before."""
    read_state, lag_ns = PpSmcState.read_state, 300 * NS_PER_MS

    async def case(bench: Bench) -> None:
        rest: list[PpSmcReading] = []
        begun: list[int] = []

        async def read_late(self: PpSmcState) -> PpSmcReading:
            look = await read_state(self)
            if look.is_ready(1):
                rest[:], begun[:] = [look], []
            elif rest:
                begun.append(look.at_ns)
                return rest[0] if look.at_ns < begun[0] + lag_ns else look
            return look

        await bench.ready()
        at_rest: list[bool] = []
        for _ in range(2):
            # The second time the axis is at the place where its search ends.
            assert await bench.driver.home_axes(["x"], lambda _: at_rest.append(not bench.unit.is_moving("1"))) == {}
            monkeypatch.setattr(PpSmcState, "read_state", read_late)
            await bench.driver.connection.state.read_state()
        assert at_rest == [True, True]

    run(case, simulate=SWITCHES, config=controller("x", axis={"homing": {"method": method, "speed": 10}}))
