"""The stream of a fleet of many: what is made for a reader is what it needs, and is bounded whatever it asks for."""

import asyncio
import json
from collections.abc import Callable
from typing import Any

import pytest
from unit.controller_states import make_controller_state

from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.memory.bus import MemoryNet
from orchestrator.client import Tutti
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.gateway.stream import fleet_state as state_module
from orchestrator.gateway.stream.fleet_state import FleetState
from orchestrator.gateway.stream.hub import StreamHub
from orchestrator.gateway.stream.merge_patch import apply_patch
from orchestrator.gateway.stream.need import EVERYTHING, MAX_ITEMS, PARTS, read_need, read_query
from orchestrator.gateway.stream.stream_view import StreamReader
from orchestrator.model.errors import Refusal
from orchestrator.model.report import LeaseState
from orchestrator.model.state import AxisState, ControllerState, FaultReport, Mode

KEYS = FleetKeys("lab")
AXIS = AxisState(
    position=0, commanded=0, velocity=0, motor_position=0, raw_counts=0, commanded_counts=0, unit="mm", moving=False,
    enabled=True, referenced=True,
)  # fmt: skip
HOT = FaultReport(code="hot", text="drive too hot", remedy="let it cool")
MANY = 1000
COUNTS_S = 0.6  # within which the counts are those of the newest states


def name_of(number: int) -> str:
    return f"hall-{number:03}"


def sample(name: str, position: float = 0.0, mode: Mode = "idle", **changes: Any) -> BusSample:
    axes = {axis: AXIS.model_copy(update={"position": position}) for axis in "xy"}
    state = make_controller_state(name, axes, mode).model_copy(update=changes)
    return BusSample(KEYS.state(name), state.to_json())


class Page:
    """What a page makes of the frames of its reader."""

    def __init__(self, reader: StreamReader) -> None:
        self.reader = reader
        self.frames = 0
        self.states = 0
        self.state: dict[str, Any] = {}
        reader.wake = self.take
        self.take()

    def take(self) -> None:
        text = self.reader.take_frame()
        if text is None:
            return
        frame, self.frames = json.loads(text), self.frames + 1
        self.states += "state" in frame
        self.state = frame["state"] if "state" in frame else apply_patch(self.state, frame["patch"])


@pytest.fixture
def drawn(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The controllers that were made ready for the stream."""
    names: list[str] = []
    show = state_module.show_controller

    def count(state: ControllerState, *more: Any) -> dict[str, Any]:
        names.append(state.controller)
        return show(state, *more)

    monkeypatch.setattr(state_module, "show_controller", count)
    return names


def run_hub(main: Callable[[VirtualClock, StreamHub], Any]) -> None:
    """Run `main` with a hub that follows a bus on which nothing is but what `main` gives it."""

    async def run(clock: VirtualClock) -> None:
        bus = MemoryNet(clock).join_process("gateway")
        hub = StreamHub(Tutti(bus, "lab", "gateway", lambda: "id"), clock)
        await hub.start()
        try:
            await main(clock, hub)
        finally:
            await hub.close()

    run_virtual(run)


def publish(hub: StreamHub, *samples: BusSample) -> None:
    for each in samples:
        hub._receive(each)


def test_a_reader_gets_what_it_needs_and_what_is_made_is_no_more(drawn: list[str]) -> None:
    async def main(clock: VirtualClock, hub: StreamHub) -> None:
        publish(hub, *(sample(name_of(number)) for number in range(MANY)))
        page = Page(hub.add_reader(read_query(["controllers/hall-01*,alarms"], "", 0)))
        shown = [name_of(number) for number in range(10, 20)]
        assert list(page.state["controllers"]) == shown
        assert page.state.keys() == {"fleet", "utc", "coordinator", "counts", "controllers", "alarms"}
        assert drawn == shown
        for step in range(10):
            publish(hub, *(sample(name_of(number), position=step + 1) for number in range(MANY)))
            await sleep_ns(clock, 50 * NS_PER_MS)
        await sleep_ns(clock, 50 * NS_PER_MS)
        assert 10 <= page.frames <= 12 and set(drawn) == set(shown)
        assert 10 * len(shown) <= len(drawn) <= 11 * len(shown)
        assert {each["axes"]["x"]["position"] for each in page.state["controllers"].values()} == {10}

    run_hub(main)


def test_counts_are_always_there_and_follow_what_no_reader_needs() -> None:
    async def main(clock: VirtualClock, hub: StreamHub) -> None:
        page = Page(hub.add_reader(read_query([""], "", 0)))
        publish(hub, *(sample(name_of(number)) for number in range(300)))
        await asyncio.sleep(COUNTS_S)
        whole = {"configured": 300, "controllers": 300, "modes": {"idle": 300}, "troubles": {}, "troubled": {}}
        assert page.state["counts"] == whole
        assert "controllers" not in page.state
        publish(hub, *(sample(name_of(number)) for number in range(300)))
        publish(hub, sample("hall-017", faults=[HOT]), sample("hall-018", mode="moving"))
        await asyncio.sleep(COUNTS_S)
        counts = page.state["counts"]
        assert counts["modes"] == {"idle": 299, "moving": 1}
        assert (counts["troubles"], counts["troubled"]) == ({"fault": 1}, {"hall-017": "fault"})
        await asyncio.sleep(1.0)  # nothing has been published for more than a second
        assert page.state["counts"]["troubles"] == {"silent": 300}  # whatever else they were
        assert len(page.state["counts"]["troubled"]) == 50
        publish(hub, *(sample(name_of(number)) for number in range(300)))
        await asyncio.sleep(COUNTS_S)
        assert page.state["counts"] == whole

    run_hub(main)


def test_a_reader_that_changes_its_need_has_the_whole_of_the_new_one_at_the_next_tick(drawn: list[str]) -> None:
    async def main(clock: VirtualClock, hub: StreamHub) -> None:
        publish(hub, *(sample(name_of(number)) for number in range(50)))
        page, other = Page(hub.add_reader(EVERYTHING)), Page(hub.add_reader(EVERYTHING))
        drawn.clear()
        for number in range(40):  # 200 changes a second cost no more than 20 frames
            page.reader.choose(read_need([f"controllers/{name_of(number)}"]))
            await sleep_ns(clock, 5 * NS_PER_MS)
        await sleep_ns(clock, 50 * NS_PER_MS)
        assert list(page.state["controllers"]) == [name_of(39)]
        assert page.frames <= 6 and len(drawn) == 0  # made before, for the other one
        assert len(other.state["controllers"]) == 50 and other.states == 1
        page.reader.choose(EVERYTHING)
        await sleep_ns(clock, 50 * NS_PER_MS)
        assert page.state == other.state
        page.reader.close()
        other.reader.close()
        assert hub.readers == 0 and not hub._views

    run_hub(main)


def test_of_a_thousand_controllers_at_50_a_second_a_reader_of_all_has_20_frames_and_nothing_waits() -> None:
    async def main(clock: VirtualClock, hub: StreamHub) -> None:
        publish(hub, *(sample(name_of(number)) for number in range(MANY)))
        page, slow = Page(hub.add_reader()), hub.add_reader()
        for step in range(20):
            publish(hub, *(sample(name_of(number), position=step + 1) for number in range(MANY)))
            await sleep_ns(clock, 20 * NS_PER_MS)
        assert 1 + 7 <= page.frames <= 1 + 8  # in 0.4 s
        await sleep_ns(clock, 50 * NS_PER_MS)
        # All has arrived one tick after the last state; nothing is kept for the reader that took nothing.
        assert {each["axes"]["x"]["position"] for each in page.state["controllers"].values()} == {20}
        frame = json.loads(slow.take_frame() or "")
        assert frame["state"] == page.state and slow.take_frame() is None
        frames = page.frames
        await sleep_ns(clock, 400 * NS_PER_MS)
        assert page.frames == frames

    run_hub(main)


def test_a_reader_that_asks_for_everything_at_50_a_second_has_20_states_and_delays_no_other() -> None:
    async def main(clock: VirtualClock, hub: StreamHub) -> None:
        publish(hub, *(sample(name_of(number)) for number in range(MANY)))
        other, greedy = Page(hub.add_reader()), Page(hub.add_reader())
        for step in range(50):
            publish(hub, *(sample(name_of(number), position=step + 1) for number in range(0, MANY, 100)))
            greedy.reader.forget()
            await sleep_ns(clock, 20 * NS_PER_MS)
        assert greedy.states == greedy.frames <= 21  # in a second
        assert other.states == 1 and 19 <= other.frames <= 21
        await sleep_ns(clock, 50 * NS_PER_MS)
        assert greedy.state == other.state
        # Where nothing changes as well.
        frames = greedy.frames
        for _ in range(50):
            greedy.reader.forget()
            await sleep_ns(clock, 20 * NS_PER_MS)
        assert greedy.frames - frames <= 20

    run_hub(main)


def test_leases_and_stages_are_those_of_the_needed_controllers() -> None:
    async def main(clock: VirtualClock) -> None:
        state = FleetState(KEYS, clock)
        for name in ("a", "ab", "b"):
            state.take_sample(sample(name))
            lease = LeaseState(
                controller=name, axis="x", holder="manual-1", actor="anna", what="", epoch=1, until_utc=None
            )
            state.take_sample(BusSample(f"{KEYS.prefix}/lease/{name}", lease.to_json()))
        part = state.compose(read_need(["leases", "controllers/a*"]))
        assert list(part["controllers"]) == ["a", "ab"] and list(part["leases"]) == ["a.x", "ab.x"]
        assert list(state.compose()["leases"]) == ["a.x", "ab.x", "b.x"]
        lease = lease.model_copy(update={"holder": None})
        state.take_sample(BusSample(f"{KEYS.prefix}/lease/b", lease.to_json()))
        assert list(state.compose()["leases"]) == ["a.x", "ab.x"]
        # A controller that comes later is found by the pattern, too.
        state.take_sample(sample("ac"))
        assert list(state.compose(read_need(["controllers/a*"]))["controllers"]) == ["a", "ab", "ac"]
        assert state.compose().keys() >= {*PARTS} - {"queue", "views", "virtual"}
        assert {*state._parts} == {*PARTS}

    run_virtual(main)


def test_a_reader_that_is_made_for_few_gets_no_controllers_of_many() -> None:
    assert read_query([], "60", 60) == read_query([], "", 1000) == EVERYTHING
    assert EVERYTHING.parts - read_query([], "60", 61).parts == {"controllers", "leases", "members"}
    assert read_query(["jobs"], "60", 61).parts == {"jobs"}
    for most in ("x", "-1", "9" * 20):
        with pytest.raises(Refusal, match="no number"):
            read_query([], most, 0)


@pytest.mark.parametrize(
    ("items", "said"),
    [
        ("controllers", "must be a list"),
        ({"a": 1}, "must be a list"),
        (["jobs"] * (MAX_ITEMS + 1), "at most 2000"),
        (["job"], "there is no part 'job'"),
        ([1], "there is no part '1'"),
        (["controllers/"], "'' is no name"),
        (["controllers/[ab]"], "'[ab]' is no name"),
        (["leases/a"], "there is no part 'leases/a'"),
    ],
)
def test_a_need_that_is_none_is_refused_with_what_there_is(items: object, said: str) -> None:
    with pytest.raises(Refusal) as caught:
        read_need(items)
    assert said in caught.value.text and "controllers/hall-1*" in caught.value.remedy
    assert caught.value.code == "bad-request"
