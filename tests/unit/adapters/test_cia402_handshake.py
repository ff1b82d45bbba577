"""Bits of the statusword that stood before an order are not taken for the answer to it."""

from typing import Any

import pytest
from unit.adapters.cia402_bench import Drives, run
from unit.adapters.test_cia402_stream import SMOOTH, smooth

from adapters.contract import JogMove
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import StartOptions
from sim.cia402.homing import HomingMode
from sim.cia402.modes import START, InterpolatedPosition, ProfilePosition

SWITCH = {"home_switch": [-3000, -2000], "travel": [-20_000, 60_000]}
_ATTAINED, _ERROR = 0x1000, 0x2000


@pytest.fixture
def standing(monkeypatch: pytest.MonkeyPatch) -> None:
    """Drives whose set-point acknowledge stands from enabling, or from the change of mode, until a set-point was given
    and taken back (canopen-python/canopen#678)."""

    def enter_mode(self: Any) -> None:
        self._now = self._next = None
        self._acknowledged, self._given = True, False

    def handle_controlword(self: Any, word: int, rising: int) -> None:
        if rising & START:
            self._given = True
            self._offer_set_point(word)
        elif not word & START and self._given:
            self._acknowledged = self._next is not None

    monkeypatch.setattr(ProfilePosition, "enter_mode", enter_mode)
    monkeypatch.setattr(ProfilePosition, "leave_mode", enter_mode)
    monkeypatch.setattr(ProfilePosition, "handle_controlword", handle_controlword)


@pytest.mark.usefixtures("standing")
def test_a_drive_whose_acknowledge_stands_after_enabling_is_moved() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        for begin, target in ((0, 20_000), (20_000, 5000)):
            t0_ns = world.clock.now_ns() + 300 * NS_PER_MS
            await world.arm(0, target, t0_ns, begin=begin)
            assert world.unit.position("1") == begin
            await world.driver.slots.present.release()
            await world.driver.slots.present.wait_for_start()
            assert (await world.driver.slots.present.wait_for_end()).state == "done"
            assert world.unit.position("1") == target
            await world.driver.set_enabled(["a"], on=False)
            await world.driver.set_enabled(["a"], on=True)

    run(main)


@pytest.mark.usefixtures("standing")
def test_a_drive_whose_acknowledge_stands_is_jogged_and_homed() -> None:
    async def main(world: Drives) -> None:
        await world.ready()
        await world.driver.jog_axis("a", JogMove(5000.0, 100_000.0, 30_000))
        await world.rest(200)
        assert world.unit.is_moving("1")
        await world.driver.jog_axis("a", JogMove(8000.0, 100_000.0, 30_000))
        await world.rest(200)
        await world.driver.stop_axes(["a"])
        await world.rest(500)
        assert not world.unit.is_moving("1")
        assert await world.driver.home_axes(["a"], lambda _: None) == {}
        assert world.unit.position("1") == 0

    run(main, simulate=SWITCH, homing={"method": "23", "speed": 8000})


def test_an_acknowledge_that_cannot_be_taken_back_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    bits = ProfilePosition.status_bits.fget
    assert bits is not None
    monkeypatch.setattr(ProfilePosition, "status_bits", property(lambda self: bits(self) | _ATTAINED))

    async def main(world: Drives) -> None:
        await world.ready()
        for order in (world.arm(0, 20_000, world.clock.now_ns() + 300 * NS_PER_MS), jog(world)):
            with pytest.raises(Refusal) as caught:
                await order
            assert caught.value.code == "not-taken"
            assert "bit 12" in caught.value.text and caught.value.remedy
        assert world.unit.position("1") == 0 and not world.unit.is_moving("1")

    async def jog(world: Drives) -> None:
        await world.driver.jog_axis("a", JogMove(5000.0, 100_000.0, 30_000))

    run(main)


def test_an_acknowledge_that_rises_before_the_commit_is_detected() -> None:
    """Another master has given the drive a set-point at the position where it stands."""

    async def main(world: Drives) -> None:
        await world.ready()
        await world.arm(0, 20_000, world.clock.now_ns() + 500 * NS_PER_MS)
        drive = world.unit.station.drive
        world.unit.station.dictionary.put_value(0x607A, 0, 0)
        drive.handle_controlword(0x3F)
        await world.rest(5)
        with pytest.raises(Refusal) as caught:
            await world.driver.slots.present.verify()
        assert caught.value.code == "not-taken"
        assert not world.unit.is_moving("1")

    run(main)


def test_a_bit_of_another_mode_does_not_show_that_a_drive_interpolates(monkeypatch: pytest.MonkeyPatch) -> None:
    bits = InterpolatedPosition.status_bits.fget
    assert bits is not None
    monkeypatch.setattr(InterpolatedPosition, "status_bits", property(lambda self: bits(self) | _ATTAINED))

    async def main(world: Drives) -> None:
        await world.ready()
        lowered = world.driver.lower_profiles(smooth(0, 20_000), StartOptions(), None)
        with pytest.raises(Refusal) as caught:
            await world.driver.slots.present.load(lowered, world.clock.now_ns() + 500 * NS_PER_MS, None)
        assert caught.value.code == "wrong-mode"

    run(main, simulate={"modes": [1, 6, 7]}, **SMOOTH)


def _keep_result(monkeypatch: pytest.MonkeyPatch, result: int, began_ms: int) -> None:
    """Let drives show the result of an earlier search until the next one has run for `began_ms`."""
    bits, begin = HomingMode.status_bits.fget, HomingMode._begin_search
    assert bits is not None

    def begin_search(self: Any) -> None:
        self._fresh = False
        self.servo.time.call_after(began_ms * NS_PER_MS, lambda: setattr(self, "_fresh", True))
        begin(self)

    def status_bits(self: Any) -> int:
        return bits(self) if getattr(self, "_fresh", False) else 0x400 | result

    monkeypatch.setattr(HomingMode, "_begin_search", begin_search)
    monkeypatch.setattr(HomingMode, "status_bits", property(status_bits))


@pytest.mark.parametrize("result", [_ATTAINED, _ERROR])
def test_the_result_of_an_earlier_homing_is_not_that_of_the_next(result: int, monkeypatch: pytest.MonkeyPatch) -> None:
    _keep_result(monkeypatch, result, began_ms=60)

    async def main(world: Drives) -> None:
        await world.ready()
        found: list[str] = []
        assert await world.driver.home_axes(["a"], found.append) == {}
        assert found == ["a"]
        assert round(world.unit.station.drive.servo.mechanical_position) in (-3000, -2000)
        assert world.unit.position("1") == 0

    run(main, simulate=SWITCH, homing={"method": "23", "speed": 8000})


def test_a_drive_that_does_not_begin_its_homing_is_named(monkeypatch: pytest.MonkeyPatch) -> None:
    _keep_result(monkeypatch, _ATTAINED, began_ms=10_000)
    monkeypatch.setattr(HomingMode, "handle_controlword", _ignore)

    async def main(world: Drives) -> None:
        await world.ready()
        failed = await world.driver.home_axes(["a"], lambda _: None)
        assert "does not begin" in failed["a"].text

    run(main, simulate=SWITCH, homing={"method": "23", "speed": 8000})


@pytest.mark.parametrize("method", ["17", "23"])
def test_an_error_of_a_homing_is_no_reference_at_any_position(method: str, monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(self: HomingMode) -> None:
        self._cancel_search("error")
        self.failed()

    monkeypatch.setattr(HomingMode, "_begin_search", fail)

    async def main(world: Drives) -> None:
        await world.ready()
        assert (await world.driver.poll()).axes["a"].commanded_counts == 0
        failed = await world.driver.home_axes(["a"], lambda _: None)
        assert failed["a"].code == "homing-failed"

    run(main, homing={"method": method})


def _ignore(self: HomingMode, word: int, rising: int) -> None:
    del self, word, rising


def test_the_present_position_is_a_reference_again_and_again() -> None:
    """Its result is the same bits each time, and never off in between."""

    async def main(world: Drives) -> None:
        await world.ready()
        for _ in range(3):
            assert await world.driver.home_axes(["a"], lambda _: None) == {}

    run(main, homing={"method": "37"})
