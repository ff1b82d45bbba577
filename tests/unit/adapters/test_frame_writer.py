"""The frames that a host writes: when they go out, what is in them, and what is published on single keys."""

from collections.abc import Callable, Coroutine
from itertools import chain, pairwise
from types import SimpleNamespace
from typing import Any

from unit.controller_states import make_controller_state

from adapters.host import frames
from adapters.host.frames import FrameSource, HostFrames
from adapters.host.single_keys import UNWATCHED_NS
from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.memory.bus import MemoryNet
from orchestrator.bus.states.frame import FRAME_NS, KEY_FRAME_NS, HostFrame, decode_frame
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.state import AxisState, ControllerState, TimeInterval
from orchestrator.model.units import Unit

KEYS = FleetKeys("lab")
NAMES = [f"c{number}" for number in range(10)]


class World:
    """A host with ten controllers, and what is received of it."""

    def __init__(self, clock: VirtualClock, moving_hz: float) -> None:
        self.clock, self.net = clock, MemoryNet(clock, seed=3)
        self.bus, self.reader = self.net.join_process("left"), self.net.join_process("reader")
        config: Any = SimpleNamespace(state=SimpleNamespace(moving_hz=moving_hz))
        source = FrameSource("left", "h1", self.bus, KEYS, clock, clock.now_ns)
        self.frames = HostFrames(source, dict.fromkeys(NAMES, config))
        self.received: list[tuple[int, HostFrame]] = []
        self.events: list[HostFrame] = []
        self.singles: list[str] = []
        self.seqs = dict.fromkeys(NAMES, 0)

    async def start(self) -> None:
        await self.reader.subscribe(KEYS.host_states(), self._receive)
        await self.reader.subscribe(KEYS.host_events(), lambda sample: self.events.append(decode_frame(sample.payload)))
        await self.frames.start()

    def _receive(self, sample: BusSample) -> None:
        self.received.append((self.clock.now_ns(), decode_frame(sample.payload)))

    def offer(self, name: str, counts: float = 0.0, **update: Any) -> None:
        """Offer a state as a poll makes it: each has its own number and instants."""
        self.seqs[name] += 1
        now_ns = self.clock.now_ns()
        within = TimeInterval(earliest_ns=now_ns - 2, latest_ns=now_ns)
        instants = {"fleet_ns": now_ns, "read_fleet_ns": now_ns, "read_within": within, "utc": self.clock.utc()}
        state = make_controller_state(name, {"x": make_axis(counts)})
        self.frames.offer_state(state.model_copy(update={"seq": self.seqs[name], **instants, **update}))

    def lines(self) -> list[tuple[int, list[str]]]:
        return [(frame.header.number, list(frame.header.lines)) for _, frame in self.received]

    def all_lines(self) -> list[str]:
        return list(chain.from_iterable(lines for _, lines in self.lines()))

    async def wait(self, ms: float) -> None:
        await sleep_ns(self.clock, round(ms * NS_PER_MS))


def make_axis(counts: float) -> AxisState:
    return AxisState(
        position=counts,
        commanded=counts,
        velocity=0.0,
        motor_position=counts,
        raw_counts=counts,
        commanded_counts=round(counts),
        unit=Unit.MM,
        moving=False,
        enabled=True,
        referenced=True,
    )


def run_world(main: Callable[[World], Coroutine[Any, Any, None]], moving_hz: float = 10.0) -> None:
    async def run(clock: VirtualClock) -> None:
        world = World(clock, moving_hz)
        await world.start()
        await main(world)
        await world.frames.close()

    run_virtual(run)


async def offer_all(world: World) -> None:
    for name in NAMES:
        world.offer(name)
    await world.wait(5)
    world.received.clear()


def test_at_rest_frames_are_empty_and_confirm_every_state_at_its_own_instant() -> None:
    async def main(world: World) -> None:
        await offer_all(world)
        for _ in range(10):
            await world.wait(200)
            for name in NAMES:
                world.offer(name)
        assert [lines for _, lines in world.lines()] == [[]] * len(world.received)
        instants = [at_ns for at_ns, _ in world.received]
        assert 4 <= len(instants) <= 5 and max(after - before for before, after in pairwise(instants)) < 405e6
        numbers = [number for number, _ in world.lines()]
        assert numbers == list(range(numbers[0], numbers[0] + len(numbers)))
        last = world.received[-1][1]
        first_state = make_controller_state("c0").model_copy(update={"seq": 1, "fleet_ns": 0})
        confirmed = last.confirmations["c0"].apply(first_state)
        assert confirmed.fleet_ns is not None and confirmed.read_within is not None
        # Offered last before the frame, not when it was sent.
        assert confirmed.fleet_ns % (200 * NS_PER_MS) < 6 * NS_PER_MS
        assert confirmed.read_within.latest_ns == confirmed.fleet_ns == confirmed.read_fleet_ns

    run_world(main)


def test_positions_are_gathered_and_modes_are_not() -> None:
    async def main(world: World) -> None:
        await offer_all(world)
        begun_ns = world.clock.now_ns()
        for ms in range(10):
            world.offer(NAMES[ms], counts=5.0 + ms)
            await world.wait(1)
        await world.wait(60)
        times = [at_ns - begun_ns for at_ns, _ in world.received]
        assert [sorted(lines) for _, lines in world.lines()] == [sorted(f"{name}/state" for name in NAMES)]
        assert times[0] < 20 * NS_PER_MS + NS_PER_MS  # 2 ms for each controller, since the frame before
        world.received.clear()
        world.offer("c1", counts=50.0)
        await world.wait(21)
        world.offer("c3", counts=51.0)
        world.offer("c2", mode="fault")
        changed_ns = world.clock.now_ns()
        await world.wait(5)
        at_ns, frame = world.received[-1]
        assert set(frame.header.lines) == {"c3/state", "c2/state"} and at_ns - changed_ns < 2 * NS_PER_MS

    run_world(main)


def test_the_fastest_poll_bounds_how_long_states_are_gathered() -> None:
    assert frames.find_gather_ns([]) == 0
    many: Any = [SimpleNamespace(state=SimpleNamespace(moving_hz=hz)) for hz in [10.0] * 400]
    assert frames.find_gather_ns(many) == NS_PER_S // 10
    assert frames.find_gather_ns(many[:3]) == 6 * NS_PER_MS


def test_every_state_of_a_controller_that_works_is_in_a_frame() -> None:
    async def main(world: World) -> None:
        await offer_all(world)
        for _ in range(20):
            world.offer("c4", mode="armed")
            world.offer("c5", leases={"x": "job"})
            await world.wait(10)
        await world.wait(100)
        seqs = [
            ControllerState.read_message(line.payload).seq
            for _, frame in world.received
            for line in frame.lines
            if line.controller == "c4"
        ]
        assert seqs == list(range(2, 22))
        assert sum(lines.count("c5/state") for _, lines in world.lines()) == 20
        assert len(world.received) <= 12  # of 40 states

    run_world(main)


def test_a_key_frame_has_every_state() -> None:
    async def main(world: World) -> None:
        await offer_all(world)
        for _ in range(KEY_FRAME_NS // (200 * NS_PER_MS) + 3):
            await world.wait(200)
            for name in NAMES:
                world.offer(name)
        keys = [frame for _, frame in world.received if frame.header.key]
        assert len(keys) == 1 and sorted(keys[0].header.lines) == sorted(f"{name}/state" for name in NAMES)
        read = ControllerState.read_message(keys[0].lines[0].payload)
        assert keys[0].confirmations[read.controller].seq == read.seq > 40

    run_world(main)


def test_the_answer_has_all_states_as_of_the_last_frame() -> None:
    async def main(world: World) -> None:
        await offer_all(world)
        for name in NAMES:
            world.offer(name)
        answer = decode_frame(await world.frames.answer_states(BusSample("", b"")))
        assert answer.header.key and len(answer.lines) == len(NAMES)
        assert {entry.seq for entry in answer.confirmations.values()} == {1}

    run_world(main)


def test_a_state_that_was_given_out_as_an_answer_is_followed_by_one_in_a_frame() -> None:
    """Otherwise a reader of both would keep the answer, although the state is as it was before it again."""

    async def main(world: World) -> None:
        await offer_all(world)
        world.offer("c1")
        world.frames.note_answer("c1")
        world.offer("c1")
        world.offer("c2")
        await world.wait(500)
        assert world.all_lines() == ["c1/state"]

    run_world(main)


def test_a_state_without_a_new_reading_is_published() -> None:
    """Its age is what has changed: a controller that is not read any more must not look as one at rest."""

    async def main(world: World) -> None:
        await offer_all(world)
        world.offer("c1", read_fleet_ns=0)
        world.offer("c1", read_fleet_ns=0)
        await world.wait(500)
        assert world.all_lines().count("c1/state") >= 1

    run_world(main)


def test_a_large_frame_is_divided_and_confirms_only_what_has_been_sent() -> None:
    async def main(world: World) -> None:
        await offer_all(world)
        text = "f" * 400_000
        for name in NAMES[:5]:
            world.offer(name, job=text)
        await world.wait(10)
        assert [len(lines) for _, lines in world.lines()] == [2, 2, 1]
        first, *_, last = [frame for _, frame in world.received]
        assert set(first.confirmations) == set(NAMES) - {"c2", "c3", "c4"}
        assert set(last.confirmations) == set(NAMES)

    run_world(main)


def test_events_of_one_instant_go_in_one_message() -> None:
    async def main(world: World) -> None:
        for name in NAMES:
            world.frames.put_event(name, b"{}")
        await world.wait(5)
        assert [[line.controller for line in frame.lines] for frame in world.events] == [NAMES]

    run_world(main)


def test_single_keys_are_published_while_something_subscribes_to_them() -> None:
    async def main(world: World) -> None:
        await offer_all(world)
        declared = len(world.bus.net.subscriptions._matches)  # pyright: ignore[reportPrivateUsage]
        subscription = await world.reader.subscribe(KEYS.state("c1"), lambda sample: world.singles.append(sample.key))
        await world.wait(5)
        for _ in range(3):
            world.offer("c1")
            world.offer("c2")
            await world.wait(200)
        assert world.singles == [KEYS.state("c1")] * 3
        assert not any("c1/state" in lines for _, lines in world.lines())  # it has not changed
        await subscription.undeclare()
        await world.wait(5)
        world.offer("c1")
        await world.wait(2 * UNWATCHED_NS / NS_PER_MS)
        assert len(world.singles) == 3
        assert len(world.bus.net.subscriptions._matches) == declared  # pyright: ignore[reportPrivateUsage]

    run_world(main)


def test_frames_go_on_when_nothing_is_offered() -> None:
    async def main(world: World) -> None:
        await world.wait(10 * FRAME_NS / NS_PER_MS)
        assert 9 <= len(world.received) <= 10

    run_world(main)


def test_what_a_command_or_the_end_has_changed_is_sent_before_it_is_answered() -> None:
    async def main(world: World) -> None:
        await offer_all(world)
        world.offer("c1", mode="fault")
        world.frames.put_event("c1", b"{}")
        world.frames.send_before_reply()
        world.frames.send_before_reply()  # nothing waits any more
        world.bus.put(KEYS.queue, b"")
        await world.wait(0.5)  # less than what waits for others
        assert world.lines() == [(world.lines()[0][0], ["c1/state"])] and len(world.events) == 1
        world.offer("c2", counts=3.0)
        world.frames.send_before_reply()
        assert len(world.received) == 1  # a position is not urgent
        world.offer("c2", mode="fault")
        await world.frames.close()
        await world.wait(5)
        assert world.all_lines() == ["c1/state", "c2/state", "c2/state"]

    run_world(main)
