"""Frames of a host: their form, and the feed that reads them, with frames that are lost, repeated, forged and broken."""

import asyncio
import json
from collections.abc import Callable, Coroutine
from typing import Any

import pytest
from unit.controller_states import make_controller_state

from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.memory.bus import MemoryBus, MemoryNet
from orchestrator.bus.states.feed import CARRIED_NS, Arrival, ControllerFeed
from orchestrator.bus.states.frame import BadFrame, FrameHeader, decode_frame, encode_entry, encode_frame
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.state import ControllerState, TimeInterval

KEYS = FleetKeys("lab")
UTC = "2026-01-02T00:00:00.000000Z"


def state_of(controller: str, seq: int, **update: Any) -> ControllerState:
    return make_controller_state(controller).model_copy(update={"seq": seq, "instance": "i1", "fleet_ns": 0, **update})


def frame(number: int, *states: ControllerState, **update: Any) -> bytes:
    """A frame of host `left` that confirms the states that it has; `same`: other entries."""
    fields = {"host": "left", "instance": "h1", "number": number, "utc": UTC, "fleet_ns": NS_PER_S, **update}
    entries = {state.controller: [state.seq, 0] for state in states} | fields.pop("same", {})
    lines = [f"{state.controller}/state" for state in states]
    return encode_frame(FrameHeader(lines=lines, states=entries, **fields), [state.to_json() for state in states])


class Taken:
    """What a feed has passed on."""

    def __init__(self) -> None:
        self.arrivals: list[Arrival] = []
        self.bad: list[str] = []

    def take_arrival(self, arrival: Arrival) -> None:
        self.arrivals.append(arrival)

    def take_bad_frame(self, text: str) -> None:
        self.bad.append(text)

    @property
    def states(self) -> list[tuple[str, int]]:
        read = [ControllerState.read_message(each.payload) for arrival in self.arrivals for each in arrival.samples]
        return [(state.controller, state.seq) for state in read]


class World:
    """A host that says what it is made to, and a feed."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock, self.net, self.taken = clock, MemoryNet(clock, seed=3), Taken()
        self.host, self.answers = self.net.join_process("left"), list[bytes]()
        self.reader = self.net.join_process("reader")
        self.feed = ControllerFeed(self.reader, KEYS, clock.now_ns, self.taken)
        self.asked = 0

    async def start(self) -> None:
        async def answer(_: BusSample) -> bytes:
            self.asked += 1
            return self.answers[min(self.asked, len(self.answers)) - 1]

        if self.answers:
            await self.host.serve(KEYS.host_states("left"), answer)
        await self.feed.start()
        await self.settle()

    async def settle(self) -> None:
        await sleep_ns(self.clock, 20 * NS_PER_MS)

    async def put(self, payload: bytes, bus: MemoryBus | None = None, host: str = "left") -> None:
        (bus or self.host).put(KEYS.host_states(host), payload)
        await self.settle()


def run_world(main: Callable[[World], Coroutine[Any, Any, None]], *answers: bytes) -> None:
    async def run(clock: VirtualClock) -> None:
        world = World(clock)
        world.answers = list(answers)
        await world.start()
        await main(world)
        await world.feed.close()

    run_virtual(run)


# The form


def test_a_frame_is_read_as_it_was_written() -> None:
    within = TimeInterval(earliest_ns=400, latest_ns=600)
    state = state_of("x", 7, fleet_ns=1000, read_within=within, read_fleet_ns=500)
    header = FrameHeader(
        host="left",
        instance="h1",
        number=3,
        utc=UTC,
        fleet_ns=5000,
        lines=["x/event", "y/link"],
        states={"x": encode_entry(state, 6, 4000), "y": [2, 0]},
    )
    read = decode_frame(encode_frame(header, [b"{}", b'{"a":1}']))
    assert [tuple(line) for line in read.lines] == [("x", "event", b"{}"), ("y", "link", b'{"a":1}')]
    older = state.model_copy(update={"seq": 6, "fleet_ns": 10, "read_within": None, "read_fleet_ns": None})
    confirmed = read.confirmations["x"].apply(older)
    assert (confirmed.fleet_ns, confirmed.read_fleet_ns, confirmed.read_within) == (1000, 500, within)
    assert confirmed.utc == "2026-01-01T23:59:59.999996Z" and confirmed.seq == 6
    assert read.confirmations["x"].apply(state) is state  # of another number
    assert read.confirmations["y"].apply(older.model_copy(update={"seq": 2})).read_within is None


def test_a_confirmation_makes_no_state_older() -> None:
    state = state_of("x", 7, fleet_ns=9000)
    confirmation = decode_frame(frame(1, same={"x": [7, 0]}, fleet_ns=5000)).confirmations["x"]
    assert confirmation.apply(state) is state


@pytest.mark.parametrize(
    ("payload", "words"),
    [
        (b"", "first line"),
        (b"[1]", "first line"),
        (b"\xff\xfe", "first line"),
        (frame(1).replace(b'"number":1', b'"number":"1e400"'), "integer"),
        (frame(1).replace(UTC.encode(), b"yesterday"), "no instant"),
        (frame(1).replace(UTC.encode(), b"0001-01-01T00:00:00+00:00"), "no instant"),
        (frame(1, state_of("x", 1)) + b"\n{}", "has 2 lines, and names 1"),
        (frame(1, state_of("x", 1)).partition(b"\n")[0], "has 0 lines, and names 1"),
        (frame(1, state_of("x", 1)).replace(b'"x/state"', b'"x/cmd"'), "names a line 'x/cmd'"),
        (frame(1, state_of("x", 1)).replace(b'"x/state"', b'"../state"'), "names a line"),
        (frame(1, same={"x": [1]}), "of 1 numbers"),
        (frame(1, same={"x": [1, -5]}), "of another day"),
        (frame(1, same={"x": [1, 10**15]}), "of another day"),
    ],
)
def test_a_broken_frame_is_left_out_with_its_reason(payload: bytes, words: str) -> None:
    with pytest.raises(BadFrame, match=words):
        decode_frame(payload)


# The feed


def test_frames_are_passed_on_in_order_and_each_once() -> None:
    async def main(world: World) -> None:
        for payload in (frame(2, state_of("x", 2)), frame(3), frame(3), frame(2, state_of("x", 2)), frame(4)):
            await world.put(payload)
        assert world.taken.states == [("x", 1), ("x", 2)]
        assert len(world.taken.arrivals) == 4  # the answer at the start, and frames 2, 3 and 4
        assert world.asked == 1 and not world.taken.bad

    run_world(main, frame(1, state_of("x", 1), key=True))


def test_a_gap_asks_for_all_states_once_and_fills_it() -> None:
    async def main(world: World) -> None:
        await world.put(frame(3, same={"x": [2, 0]}))  # frame 2 had state 2, and was lost
        assert world.asked == 2 and world.taken.states == [("x", 1), ("x", 2)]
        await world.put(frame(4, same={"x": [2, 0]}))
        assert world.asked == 2

    run_world(main, frame(1, state_of("x", 1), key=True), frame(3, state_of("x", 2), key=True))


def test_without_an_answer_a_gap_asks_again_and_a_key_frame_ends_it() -> None:
    async def main(world: World) -> None:
        for number in range(3, 8):  # the answers are as old as the first one
            await world.put(frame(number, same={"x": [2, 0]}))
            await sleep_ns(world.clock, 300 * NS_PER_MS)
        assert world.asked == 6 and world.taken.states == [("x", 1)]
        await world.put(frame(8, state_of("x", 2), key=True))
        await sleep_ns(world.clock, NS_PER_S)
        await world.put(frame(9, same={"x": [2, 0]}))
        assert world.asked == 6 and world.taken.states[-1] == ("x", 2)

    run_world(main, frame(1, state_of("x", 1), key=True))


def test_an_answer_that_frames_have_overtaken_brings_back_no_old_state() -> None:
    async def main(world: World) -> None:
        late = asyncio.ensure_future(world.feed._request_all("left", world.feed._hosts["left"]))  # pyright: ignore[reportPrivateUsage]
        world.host.put(KEYS.host_states("left"), frame(2, state_of("x", 5), same={"y": [1, 0]}))
        await late
        await world.settle()
        assert world.taken.states[-1] == ("x", 5)
        assert ("x", 3) not in world.taken.states[2:]

    run_world(
        main,
        frame(1, state_of("x", 1), state_of("y", 1), key=True),
        frame(1, state_of("x", 3), state_of("y", 1), key=True),
    )


def test_a_host_that_starts_again_is_read_from_its_beginning() -> None:
    async def main(world: World) -> None:
        await world.put(frame(1, state_of("x", 1, instance="i2"), instance="h2", key=True))
        assert world.taken.states == [("x", 9), ("x", 1)]
        await world.put(frame(5, instance="h3"))  # joined in the middle
        assert world.asked == 2

    run_world(main, frame(40, state_of("x", 9), key=True), frame(5, state_of("x", 3), instance="h3", key=True))


def test_a_host_cannot_publish_what_another_one_carries() -> None:
    async def main(world: World) -> None:
        other = world.net.join_process("right")
        forged = frame(1, state_of("x", 99), host="right", key=True)
        await world.put(forged, other, "right")
        assert world.taken.states == [("x", 1)] and "right publishes x" in world.taken.bad[0]
        await world.put(frame(2, state_of("x", 99)), other, "right")  # under a name that is not on its key
        assert world.taken.states == [("x", 1)] and "on the key of host right" in world.taken.bad[1]
        await sleep_ns(world.clock, CARRIED_NS)  # its host is gone: the controller has moved to another one
        await world.put(frame(2, state_of("x", 100), host="right"), other, "right")
        assert world.taken.states[-1] == ("x", 100)

    run_world(main, frame(1, state_of("x", 1), key=True))


def test_the_fleet_file_says_which_host_may_publish_a_controller() -> None:
    """Also where the right host has never been there."""

    async def main(clock: VirtualClock) -> None:
        world = World(clock)
        world.feed = ControllerFeed(world.reader, KEYS, clock.now_ns, world.taken, {"x": "right", "y": "left"}.get)
        await world.start()
        await world.put(frame(1, state_of("x", 1), state_of("y", 1), key=True))
        assert world.taken.states == [("y", 1)] and "left publishes x" in world.taken.bad[0]
        assert set(world.taken.arrivals[0].confirmations) == {"y"}
        await world.feed.close()

    run_virtual(main)


def test_one_state_that_cannot_be_read_costs_no_other() -> None:
    async def main(world: World) -> None:
        payload = frame(2, state_of("x", 2), state_of("y", 2))
        broken = payload.replace(state_of("x", 2).to_json(), b'{"no": "state"}')
        await world.put(broken)
        payloads = [json.loads(sample.payload) for sample in world.taken.arrivals[-1].samples]
        assert payloads[0] == {"no": "state"} and payloads[1]["seq"] == 2
        await world.put(b"\x00\x01")
        assert len(world.taken.bad) == 1

    run_world(main, frame(1, state_of("x", 1), state_of("y", 1), key=True))


def test_a_host_without_frames_is_read_on_the_keys_of_its_controllers() -> None:
    """A host of protocol 1.5 announces each of its controllers."""

    async def main(world: World) -> None:
        old = world.net.join_process("old")

        async def answer(_: BusSample) -> bytes:
            return state_of("z", 1).to_json()

        await old.serve(KEYS.state("z"), answer)
        token = await old.announce(KEYS.live("controller", "z", "1"))
        await world.settle()
        old.put(KEYS.state("z"), state_of("z", 2).to_json())
        await world.settle()
        assert world.taken.states == [("z", 1), ("z", 2)]
        await token.undeclare()
        await world.settle()
        old.put(KEYS.state("z"), state_of("z", 3).to_json())
        await world.settle()
        assert world.taken.states == [("z", 1), ("z", 2)]

    run_world(main)
