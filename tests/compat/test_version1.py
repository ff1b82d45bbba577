"""Plug-ins of version 1 of the contract: they load once more, with a warning, and do what they did."""

import importlib
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any, cast

import pytest

from adapters.compat.version1 import PluginConnectedDriver, PluginDriver
from adapters.contract import Driver, DriverSetup, HostInterval, Lowered, MoveOutcome, SlotState
from adapters.host.makes import find_make
from orchestrator.clock.virtual import run_virtual
from orchestrator.conformance.suite import list_checks, run_check
from orchestrator.model.errors import Refusal
from orchestrator.model.state import StepCosts
from sim.core.vectors import find_simulator

ACME = Path(__file__).parent / "adapter-acme-1"
MOVE = Lowered("host", {"x": 1.0}, {"x": 0.0}, (), 0, StepCosts(arm_ns=1, disarm_ns=1, stop_ns=1), ())


@pytest.fixture
def acme(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The acme example as it was with version 1, installed."""
    metadata = tmp_path / "tutti_acme-0.1.0.dist-info"
    metadata.mkdir()
    (metadata / "METADATA").write_text("Metadata-Version: 2.1\nName: tutti-acme\nVersion: 0.1.0\n")
    points = "[tutti.adapters]\nacme = acme_adapter:MAKE\n[tutti.simulators]\nacme = acme_simulator:ACME\n"
    (metadata / "entry_points.txt").write_text(points)
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.syspath_prepend(ACME)
    importlib.invalidate_caches()
    yield
    for cached in (find_make, find_simulator):
        cached.cache_clear()
    for module in [each for each in sys.modules if each.startswith("acme_")]:
        del sys.modules[module]


@pytest.mark.usefixtures("acme")
def test_a_make_of_version_1_loads_with_a_warning_and_keeps_the_contract() -> None:
    with pytest.warns(FutureWarning, match=r"acme of package tutti-acme 0\.1\.0 .* version 1 .* next release"):
        find_make("acme")
    results = [run_check(each) for each in list_checks("acme") if each.part == "contract"]
    assert not [each for each in results if each.state == "broken"]
    assert len([each for each in results if each.state == "holds"]) > 10


class Methods:
    """The methods of a driver of version 1 that a step calls."""

    def __init__(self) -> None:
        self.calls: list[str] = []

    async def _note(self, call: str) -> Any:
        self.calls.append(call)

    def __getattr__(self, name: str) -> Callable[..., Any]:
        return lambda *values: self._note(f"{name} {len(values)}")


def make_old_driver(base: type, **more: Any) -> Any:
    """An instance of a class of version 1, without what a step does not call."""

    async def note(self: Any, name: str, result: Any) -> Any:
        self.calls.append(name)
        return result

    def method(name: str, result: Any = None) -> Any:
        return lambda self, *values: note(self, name, result)

    names = ["verify_armed", "go", "disarm_move"]
    members: dict[str, Any] = {each: method(each) for each in names}
    members["arm_move"] = method("arm_move", {"wire": 1})
    members["wait_for_start"] = method("wait_for_start", {"x": HostInterval(1, 2)})
    members["wait_for_end"] = method("wait_for_end", MoveOutcome("done", {}))
    abstract = {each: None for each in Driver.__abstractmethods__ if each != "slots"}
    members |= abstract | {each: method(each) for each in more.get("also", ())} | more.get("members", {})
    with pytest.warns(FutureWarning, match="version 1 of the contract; the next release"):
        driver = type(base)("Old", (base,), members)()
    driver.calls = []
    return driver


def test_a_driver_of_version_1_has_one_slot_with_its_methods() -> None:
    driver = make_old_driver(PluginDriver)

    async def main(_: object) -> None:
        slot = driver.slots.present
        assert driver.slots is driver.slots and driver.slots.following is None
        assert await slot.load(MOVE, 0, None, "behind") == {"wire": 1}
        await slot.verify()
        await slot.release()
        await slot.wait_for_start()
        await slot.wait_for_end()
        assert slot.state is SlotState.ENDED
        await driver.slots.unload()

    run_virtual(main)
    words = ["arm_move", "verify_armed", "go", "wait_for_start", "wait_for_end", "disarm_move"]
    assert driver.calls == words


def test_a_driver_of_version_1_that_loads_a_following_move_has_two_slots() -> None:
    also = ["load_next", "verify_next", "release_next", "unload_next"]
    driver = make_old_driver(
        PluginDriver, also=also, members={"take_next": lambda self: self.calls.append("take_next")}
    )

    async def main(_: object) -> None:
        slots = driver.slots
        await slots.present.load(MOVE, 0, None)
        following = slots.following
        await following.load(MOVE, 0, None, "beside")
        await following.unload()
        await following.load(MOVE, 0, None, "beside")
        await following.verify()
        await following.release()
        slots.advance()
        await slots.present.wait_for_start()
        await slots.present.unload()

    run_virtual(main)
    loads = ["arm_move", "load_next", "unload_next", "load_next", "verify_next", "release_next"]
    assert driver.calls == [*loads, "take_next", "wait_for_start", "disarm_move"]


def test_the_defaults_of_version_1_are_still_there() -> None:
    driver = make_old_driver(PluginDriver)

    async def main(_: object) -> None:
        for call in (driver.verify_next, driver.release_next, lambda: driver.load_next(MOVE, 0, None)):
            with pytest.raises(Refusal):
                await call()
        await driver.unload_next()
        assert driver.crystal_rate() is None and driver.start_latency() is None

    run_virtual(main)


def test_a_driver_of_version_1_with_a_mover_calls_it_by_its_former_names() -> None:
    mover, calls = Methods(), list[str]()

    class Log:
        def info(self, text: str, **fields: object) -> None:
            calls.append(text)

    async def arm_move(self: Any, *values: Any) -> dict[str, int]:
        return {}

    with pytest.warns(FutureWarning):
        old = type(PluginConnectedDriver)(
            "Old",
            (PluginConnectedDriver,),
            {each: None for each in Driver.__abstractmethods__ if each != "slots"} | {"arm_move": arm_move},
        )
    setup = cast(DriverSetup, type("Setup", (), {"log": Log()}))
    driver: Any = cast(Any, old)(setup)
    driver._connection = type("Connection", (), {"mover": mover})

    async def main(_: object) -> None:
        slot = driver.slots.present
        await slot.load(MOVE, 0, None)
        await slot.verify()
        await slot.release(1, 2)
        await slot.unload()

    run_virtual(main)
    assert mover.calls == ["verify_armed 0", "schedule_start 2", "disarm_move 0"]
