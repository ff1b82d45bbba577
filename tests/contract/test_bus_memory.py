"""Guarantees of the in-memory bus beyond the contract: faults on demand, one outcome per seed, processes kept apart."""

import asyncio
from contextvars import ContextVar

import pytest

from orchestrator.bus.base import BusSample, NoReply, Priority, RequestRefused, RequestTimeout
from orchestrator.bus.memory.bus import LEASE_NS, MemoryBus, MemoryNet
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, sleep_ns
from orchestrator.clock.virtual import VirtualClock, VirtualProcess, run_virtual

WHO: ContextVar[str] = ContextVar("who", default="medium")


async def _echo(sample: BusSample) -> bytes:
    return sample.payload


def test_a_sample_takes_time_and_one_seed_gives_one_outcome() -> None:
    def log_of(seed: int) -> list[tuple[int, str, bytes]]:
        log: list[tuple[int, str, bytes]] = []

        async def main(clock: VirtualClock) -> None:
            net = MemoryNet(clock, seed=seed)
            a, b = net.join_process("a"), net.join_process("b")
            await b.subscribe("**", lambda sample: log.append((clock.now_ns(), sample.key, sample.payload)))
            for number in range(500):
                a.put(f"k/{number % 3}", str(number).encode())
                await sleep_ns(clock, NS_PER_MS // 10)
            await sleep_ns(clock, NS_PER_S)

        run_virtual(main)
        return log

    log = log_of(1)
    assert len(log) == 500
    assert log == log_of(1)
    assert log != log_of(2)
    delays_ns = sorted(at_ns - int(payload) * NS_PER_MS // 10 for at_ns, _, payload in log)
    assert delays_ns[0] >= 40 * NS_PER_US
    assert 50 * NS_PER_US < delays_ns[250] < 80 * NS_PER_US
    assert [number for _, _, number in log] != sorted([number for _, _, number in log], key=int)


def test_everything_runs_in_the_context_that_declared_it() -> None:
    ran: list[tuple[str, str]] = []

    async def main(clock: VirtualClock) -> None:
        net = MemoryNet(clock)
        a, b = net.join_process("a"), net.join_process("b")

        async def handle(sample: BusSample) -> bytes:
            ran.append(("handler", WHO.get()))
            await sleep_ns(clock, NS_PER_MS)
            ran.append(("handler", WHO.get()))
            return b""

        async def declare() -> None:
            WHO.set("b")
            await b.subscribe("k", lambda _: ran.append(("callback", WHO.get())))
            await b.watch("live/*", lambda *_: ran.append(("watch", WHO.get())))
            await b.serve("q", handle)

        async def use() -> None:
            WHO.set("a")
            a.put("k", b"")
            await a.announce("live/a")
            await a.request("q", b"", 1.0)
            ran.append(("asker", WHO.get()))

        await asyncio.create_task(declare())
        await asyncio.create_task(use())

    run_virtual(main)
    assert sorted(ran) == [("asker", "a"), ("callback", "b"), ("handler", "b"), ("handler", "b"), ("watch", "b")]


def test_data_sent_before_a_process_died_or_froze_arrives() -> None:
    async def main(clock: VirtualClock) -> None:
        net = MemoryNet(clock)
        got: list[bytes] = []
        await net.join_process("test").subscribe("k", lambda sample: got.append(sample.payload))
        processes: dict[str, VirtualProcess] = {}
        for name in ("a", "b"):
            process = processes[name] = VirtualProcess(clock.loop, name)
            bus = process.run_inside(lambda name=name: net.join_process(name))

            async def put_and_serve(name: str = name, bus: MemoryBus = bus) -> None:
                await bus.serve(f"q/{name}", _echo)
                bus.put("k", name.encode(), Priority.EVENT)

            await process.start_task(put_and_serve())
        processes["a"].kill()
        net.kill_process("a")
        processes["b"].freeze()
        net.suspend_process("b")
        await sleep_ns(clock, NS_PER_S)
        assert sorted(got) == [b"a", b"b"]
        with pytest.raises(NoReply):
            await net.join_process("c").request("q/a", b"", 1.0)
        with pytest.raises(RequestTimeout):
            await net.join_process("d").request("q/b", b"", 1.0)

    run_virtual(main)


def test_a_hung_process_gets_estops_first_and_state_up_to_the_limit() -> None:
    async def main(clock: VirtualClock) -> None:
        net = MemoryNet(clock, queue_limit=10)
        a, b = net.join_process("a"), net.join_process("b")
        got: list[BusSample] = []
        await b.subscribe("**", got.append)
        net.suspend_process("b")
        for number in range(20):
            a.put("state", str(number).encode())
            a.put("event", str(number).encode(), Priority.EVENT)
        await sleep_ns(clock, NS_PER_S)
        a.put("estop", b"", Priority.ESTOP)
        await sleep_ns(clock, NS_PER_S)
        assert got == []
        net.resume_process("b")
        await sleep_ns(clock, NS_PER_S)
        assert got[0].key == "estop"
        assert [int(sample.payload) for sample in got if sample.key == "state"] == list(range(10))
        assert [int(sample.payload) for sample in got if sample.key == "event"] == list(range(20))

    run_virtual(main)


def test_data_put_by_a_hung_process_waits_as_backlog() -> None:
    async def main(clock: VirtualClock) -> None:
        net = MemoryNet(clock)
        a, b = net.join_process("a"), net.join_process("b")
        got: list[bytes] = []
        await b.subscribe("k", lambda sample: got.append(sample.payload))
        net.suspend_process("a")
        for number in range(3):
            a.put("k", str(number).encode(), Priority.EVENT)
        assert a.backlog == 3
        net.resume_process("a")
        assert a.backlog == 0
        await sleep_ns(clock, NS_PER_S)
        assert got == [b"0", b"1", b"2"]

    run_virtual(main)


def test_a_hang_is_presence_for_a_lease_and_then_absence() -> None:
    async def main(clock: VirtualClock) -> None:
        net = MemoryNet(clock)
        a, b = net.join_process("a"), net.join_process("b")
        seen: list[tuple[int, bool]] = []
        await a.watch("live/b", lambda _, present: seen.append((clock.now_ns(), present)))
        await b.announce("live/b")
        await b.serve("q", _echo)
        net.suspend_process("b")
        await sleep_ns(clock, LEASE_NS - NS_PER_S)
        with pytest.raises(RequestTimeout):
            await a.request("q", b"", 0.5)
        assert [present for _, present in seen] == [True]
        await sleep_ns(clock, NS_PER_S)
        assert [present for _, present in seen] == [True, False]
        assert seen[1][0] >= LEASE_NS
        with pytest.raises(NoReply):
            await a.request("q", b"", 0.5)
        net.resume_process("b")
        await sleep_ns(clock, NS_PER_S)
        assert [present for _, present in seen] == [True, False, True]
        assert await a.request("q", b"x", 0.5) == b"x"

    run_virtual(main)


def test_a_partition_separates_only_its_two_sides() -> None:
    async def main(clock: VirtualClock) -> None:
        net = MemoryNet(clock)
        a, b, c, d = (net.join_process(name) for name in "abcd")
        got: dict[str, list[bytes]] = {"a": [], "b": [], "c": [], "d": []}
        present: dict[str, dict[str, bool]] = {"a": {}, "c": {}}
        for bus in (a, b, c, d):
            await bus.subscribe("k", lambda sample, name=bus.name: got[name].append(sample.payload))
            await bus.announce(f"live/{bus.name}")
        await c.serve("q", _echo)
        await d.serve("p", _echo)
        await a.watch("live/*", present["a"].__setitem__)
        await c.watch("live/*", present["c"].__setitem__)
        await sleep_ns(clock, NS_PER_S)
        a.put("k", b"first", Priority.EVENT)
        net.partition_net({"a", "b"}, {"c"})
        a.put("k", b"second", Priority.EVENT)
        c.put("k", b"from c", Priority.EVENT)
        with pytest.raises(RequestTimeout):
            await a.request("q", b"", 1.0)
        assert await a.request("p", b"x", 1.0) == b"x"
        assert got["b"] == [b"first", b"second"]
        assert got["c"] == [b"from c"]
        assert sorted(got["d"]) == [b"first", b"from c", b"second"]
        assert all(present["a"].values())
        await sleep_ns(clock, LEASE_NS)
        assert present["a"] == {"live/a": True, "live/b": True, "live/c": False, "live/d": True}
        assert present["c"] == {"live/a": False, "live/b": False, "live/c": True, "live/d": True}
        net.heal_partition()
        assert await a.request("q", b"x", 1.0) == b"x"
        await sleep_ns(clock, NS_PER_S)
        assert all(present["a"].values())
        assert all(present["c"].values())

    run_virtual(main)


def test_one_way_can_be_blocked_from_one_process_or_from_all() -> None:
    async def main(clock: VirtualClock) -> None:
        net = MemoryNet(clock)
        a, b, c = (net.join_process(name) for name in "abc")
        got: dict[str, list[bytes]] = {"a": [], "b": [], "c": []}
        present: dict[str, bool] = {}
        for bus in (a, b, c):
            await bus.subscribe("k", lambda sample, name=bus.name: got[name].append(sample.payload))
        await b.serve("q", _echo)
        await b.watch("live/*", present.__setitem__)
        net.block_way("a", "b")
        await a.announce("live/a")
        a.put("k", b"from a", Priority.EVENT)
        b.put("k", b"from b", Priority.ESTOP)
        with pytest.raises(RequestTimeout):
            await a.request("q", b"", 0.5)
        assert await c.request("q", b"x", 0.5) == b"x"
        assert got == {"a": [b"from b", b"from a"], "b": [b"from b"], "c": [b"from b", b"from a"]}
        assert present == {}
        net.open_way("a", "b")
        assert await a.request("q", b"x", 0.5) == b"x"
        assert present == {"live/a": True}
        net.block_way(None, "b")
        for bus in (a, b, c):
            bus.put("k", b"last", Priority.EVENT)
        with pytest.raises(RequestTimeout):
            await c.request("q", b"", 0.5)
        assert got["b"][1:] == [b"last"] and got["a"][2:] == got["c"][2:] == [b"last"] * 3
        net.open_way(None, "b")
        assert await c.request("q", b"x", 0.5) == b"x"

    run_virtual(main)


def test_a_death_is_detected_within_milliseconds_and_the_name_is_free_again() -> None:
    async def main(clock: VirtualClock) -> None:
        net = MemoryNet(clock)
        a, b = net.join_process("a"), net.join_process("b")
        seen: list[tuple[int, str, bool]] = []
        await a.watch("live/*", lambda key, present: seen.append((clock.now_ns(), key, present)))
        await b.announce("live/1")
        await b.serve("q", _never)
        await sleep_ns(clock, NS_PER_S)
        asked = asyncio.ensure_future(a.request("q", b"", 5.0))
        await sleep_ns(clock, NS_PER_MS)
        killed_ns = clock.now_ns()
        net.kill_process("b")
        with pytest.raises(NoReply):
            await asked
        again = net.join_process("b")
        await again.announce("live/2")
        await sleep_ns(clock, NS_PER_S)
        assert [(key, present) for _, key, present in seen] == [("live/1", True), ("live/1", False), ("live/2", True)]
        assert 0 < seen[1][0] - killed_ns < 10 * NS_PER_MS
        with pytest.raises(ValueError, match="on the bus already"):
            net.join_process("b")

    run_virtual(main)


def test_faults_of_a_closed_session_have_no_effect() -> None:
    async def main(clock: VirtualClock) -> None:
        net = MemoryNet(clock)
        await net.join_process("a").close()
        net.suspend_process("a")
        net.resume_process("a")
        net.kill_process("a")
        await net.join_process("a").close()

    run_virtual(main)


async def _never(_: BusSample) -> bytes:
    await asyncio.Event().wait()
    return b""


def test_a_message_that_is_too_large_for_a_process_is_left_out() -> None:
    async def main(clock: VirtualClock) -> None:
        net = MemoryNet(clock)
        host, other = net.join_process("host", max_message_bytes=10), net.join_process("other")
        got: list[BusSample] = []

        async def answer(sample: BusSample) -> bytes:
            return sample.payload

        await host.subscribe("t/**", got.append)
        await host.serve("t/cmd/*", answer)
        other.put("t/fits", b"x" * 10, Priority.EVENT)
        other.put("t/large", b"x" * 11, Priority.EVENT)
        other.put("t/estop", b"x" * 11, Priority.ESTOP)
        with pytest.raises(RequestRefused, match="at most 10 bytes"):
            await other.request("t/cmd/do", b"x" * 11, 1.0)
        assert await other.request("t/cmd/do", b"x" * 10, 1.0) == b"x" * 10
        assert sorted(got) == [BusSample("t/estop", b""), BusSample("t/fits", b"x" * 10)]

    run_virtual(main)
