"""The slots of a controller: the states of a move, and the change of roles at the end of the present one."""

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from typing import Any

import pytest

from adapters.contract import HostInterval, Lowered, MoveOutcome, MoveSlot, MoveSlots, SlotState
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.state import StepCosts

MOVE = Lowered("host", {"x": 1.0}, {"x": 0.0}, (), 0, StepCosts(arm_ns=1, disarm_ns=1, stop_ns=1), ())
SPAN = HostInterval(1, 2)


class Mover:
    """A mover that notes its calls. error: what each call raises. may_end: while cleared, no move ends."""

    def __init__(self) -> None:
        self.calls: list[str] = []
        self.error: Exception | None = None
        self.may_end = asyncio.Event()
        self.may_end.set()

    def _note(self, call: str) -> None:
        self.calls.append(call)
        if self.error is not None:
            raise self.error

    async def load(self, lowered: Lowered, t0_ns: int, mapping: object, place: str) -> Mapping[str, int]:
        self._note(f"load {place}")
        return {"wire": t0_ns}

    async def verify(self) -> None:
        self._note("verify")

    async def release(self, start_tolerance_ns: int, advance_ns: int) -> None:
        self._note(f"release {start_tolerance_ns} {advance_ns}")

    async def unload(self) -> None:
        self._note("unload")

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        self._note("start")
        return {"x": SPAN}

    async def wait_for_end(self) -> MoveOutcome:
        self._note("end")
        await self.may_end.wait()
        return MoveOutcome("done", {"x": SPAN})


def run(body: Callable[[Mover, MoveSlot], Coroutine[Any, Any, None]]) -> None:
    async def main() -> None:
        mover = Mover()
        await body(mover, MoveSlot(mover))

    asyncio.run(main())


def test_a_move_goes_through_the_states_of_its_slot() -> None:
    async def body(mover: Mover, slot: MoveSlot) -> None:
        states = [slot.state]
        assert await slot.load(MOVE, 5, None) == {"wire": 5}
        states.append(slot.state)
        for call in (slot.verify, lambda: slot.release(3, 4), slot.wait_for_start, slot.wait_for_end, slot.unload):
            await call()
            states.append(slot.state)
        assert [each.value for each in states] == [
            "empty",
            "loaded",
            "verified",
            "released",
            "moving",
            "ended",
            "empty",
        ]
        assert mover.calls == ["load at rest", "verify", "release 3 4", "start", "end", "unload"]

    run(body)


@pytest.mark.parametrize("call", ["verify", "release", "wait_for_start", "wait_for_end"])
def test_an_empty_slot_refuses_what_needs_a_move(call: str) -> None:
    async def body(mover: Mover, slot: MoveSlot) -> None:
        with pytest.raises(Refusal) as caught:
            await getattr(slot, call)()
        assert caught.value.code == "not-armed" and not mover.calls

    run(body)


def test_an_empty_slot_can_be_unloaded_again() -> None:
    async def body(mover: Mover, slot: MoveSlot) -> None:
        await slot.unload()
        await slot.unload()
        assert mover.calls == ["unload", "unload"] and slot.state is SlotState.EMPTY

    run(body)


@pytest.mark.parametrize(
    ("call", "before", "after"),
    [
        ("load", SlotState.EMPTY, SlotState.EMPTY),
        ("load", SlotState.ENDED, SlotState.EMPTY),
        ("load", SlotState.MOVING, SlotState.MOVING),
        ("verify", SlotState.LOADED, SlotState.LOADED),
        ("release", SlotState.VERIFIED, SlotState.RELEASED),
        ("wait_for_start", SlotState.RELEASED, SlotState.ENDED),
        ("wait_for_end", SlotState.MOVING, SlotState.ENDED),
    ],
)
def test_a_call_that_fails_leaves_the_state_that_is_certain(call: str, before: SlotState, after: SlotState) -> None:
    async def body(mover: Mover, slot: MoveSlot) -> None:
        for way in (slot.load, slot.verify, slot.release, slot.wait_for_start, slot.wait_for_end):
            if slot.state is before:
                break
            await (way(MOVE, 0, None) if way == slot.load else way())  # type: ignore[call-arg]
        mover.error = ControllerFault("no-answer", "silent", "")
        with pytest.raises(ControllerFault):
            await (slot.load(MOVE, 0, None) if call == "load" else getattr(slot, call)())
        assert slot.state is after

    run(body)


def test_the_end_of_an_earlier_move_does_not_end_a_later_one() -> None:
    async def body(mover: Mover, slot: MoveSlot) -> None:
        await slot.load(MOVE, 0, None)
        await slot.release()
        mover.may_end.clear()
        ending = asyncio.ensure_future(slot.wait_for_end())
        await asyncio.sleep(0)
        await slot.unload()
        await slot.load(MOVE, 1, None)
        mover.may_end.set()
        await ending
        assert slot.state is SlotState.LOADED

    run(body)


def run_pair(body: Callable[[MoveSlots, list[str]], Coroutine[Any, Any, None]]) -> None:
    async def main() -> None:
        calls: list[str] = []
        slots = MoveSlots(MoveSlot(Mover()), MoveSlot(Mover()), lambda: calls.append("take over"))
        await slots.present.load(MOVE, 0, None)
        await slots.present.release()
        await body(slots, calls)

    asyncio.run(main())


def test_slots_change_roles_at_the_end_of_the_present_move() -> None:
    async def body(slots: MoveSlots, calls: list[str]) -> None:
        first, second = slots.present, slots.following
        assert second is not None
        await second.load(MOVE, 1, None, "beside")
        slots.advance()
        assert (slots.present, slots.following) == (second, first) and calls == ["take over"]
        assert (first.state, second.state) == (SlotState.EMPTY, SlotState.LOADED)

    run_pair(body)


def test_nothing_follows_that_is_not_loaded() -> None:
    async def body(slots: MoveSlots, calls: list[str]) -> None:
        for pair in (slots, MoveSlots(slots.present)):
            with pytest.raises(Refusal) as caught:
                pair.advance()
            assert caught.value.code == "not-armed" and not calls

    run_pair(body)


def test_a_stop_leaves_a_released_move_until_its_end_and_nothing_else() -> None:
    async def body(slots: MoveSlots, calls: list[str]) -> None:
        assert slots.following is not None and not calls
        await slots.following.load(MOVE, 1, None, "beside")
        await slots.following.release()
        slots.drop()
        assert (slots.present.state, slots.following.state) == (SlotState.RELEASED, SlotState.EMPTY)
        await slots.present.load(MOVE, 2, None)
        slots.drop()
        assert slots.present.state is SlotState.EMPTY

    run_pair(body)


def test_both_slots_are_unloaded_by_one_call() -> None:
    async def body(slots: MoveSlots, calls: list[str]) -> None:
        assert slots.following is not None and not calls
        await slots.following.load(MOVE, 1, None, "beside")
        await slots.unload()
        assert (slots.present.state, slots.following.state) == (SlotState.EMPTY, SlotState.EMPTY)

    run_pair(body)
