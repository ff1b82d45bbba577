"""One contract over both buses."""

import asyncio
import sys
from collections.abc import Callable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from bus_worlds import LIMIT_S, Body, World, linked, request_until, run_live, run_memory, until

from orchestrator.bus.base import (
    BusClosed,
    BusSample,
    DoubleServer,
    NoReply,
    OtherServer,
    Priority,
    RequestRefused,
    RequestTimeout,
    find_only_server,
)
from orchestrator.bus.estop import put_estop
from orchestrator.bus.keys import FleetKeys
from orchestrator.model.messages import EstopMessage

Run = Callable[[Body], None]


@pytest.fixture(params=["memory", pytest.param("live", marks=pytest.mark.live)])
def run(request: pytest.FixtureRequest) -> Run:
    return run_memory if request.param == "memory" else run_live


def test_samples_are_in_order_per_key_and_priority(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        got: list[BusSample] = []
        await b.subscribe("t/n/*", got.append)
        await linked(a, b)
        for number in range(300):
            for key in ("t/n/x", "t/n/y"):
                a.put(key, str(number).encode(), Priority.EVENT)
        await until(lambda: len(got) == 600)
        for key in ("t/n/x", "t/n/y"):
            assert [int(sample.payload) for sample in got if sample.key == key] == list(range(300))

    run(body)


def test_an_estop_overtakes_queued_messages(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        got: list[str] = []
        await b.subscribe("t/**", lambda sample: got.append(sample.key))
        await linked(a, b)
        for _ in range(1000):
            a.put("t/event", b"e" * 2000, Priority.EVENT)
        a.put("t/estop", b"", Priority.ESTOP)
        await until(lambda: got.count("t/event") == 1000)
        assert got.index("t/estop") < len(got) - 1

    run(body)


def test_an_estop_without_a_fleet_reaches_all_without_waiting_for_them(run: Run) -> None:
    async def body(world: World) -> None:
        hearers = [await world.join(name) for name in "ab"]
        got: dict[str, list[BusSample]] = {"one": [], "two": []}
        for hearer, fleet in zip(hearers, got, strict=True):
            await hearer.subscribe(FleetKeys(fleet).estop, got[fleet].append)
        for hearer in hearers:
            await linked(hearer, hearer)
        # The publisher has just joined: it has not discovered any other session yet.
        put_estop(await world.join("c"), None, "e1", "anna", "smoke")
        await until(lambda: all(got.values()))
        heard = [EstopMessage.model_validate_json(sample.payload) for samples in got.values() for sample in samples]
        assert heard == [EstopMessage(event="e1", actor="anna", reason="smoke")] * 2

    run(body)


def test_only_an_estop_is_sent_on_a_key_expression(run: Run) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        for priority in (Priority.STATE, Priority.EVENT):
            with pytest.raises(ValueError, match="without '\\*'"):
                a.put("t/*/x", b"", priority)

    run(body)


def test_own_samples_are_seen(run: Run) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        got: list[BusSample] = []
        await a.subscribe("t/own/**", got.append)
        await linked(a, a)
        for priority in Priority:
            a.put("t/own/x", priority.value.encode(), priority)
        await until(lambda: len(got) == 3)
        assert sorted(sample.payload for sample in got) == [b"estop", b"event", b"state"]

    run(body)


def test_a_put_from_inside_a_callback_works(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        back: list[BusSample] = []
        await b.subscribe("t/ping", lambda sample: b.put("t/pong", sample.payload, Priority.EVENT))
        await a.subscribe("t/pong", back.append)
        await linked(a, b)
        await linked(b, a)
        for number in range(20):
            a.put("t/ping", str(number).encode(), Priority.EVENT)
        await until(lambda: len(back) == 20)

    run(body)


def test_nothing_is_called_after_undeclare(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        got: list[BusSample] = []
        subscription = await b.subscribe("t/x", got.append)
        await linked(a, b)
        a.put("t/x", b"", Priority.EVENT)
        await subscription.undeclare()
        known = len(got)
        a.put("t/x", b"", Priority.EVENT)
        await linked(a, b)
        assert len(got) == known
        await subscription.undeclare()

    run(body)


def test_a_stopped_receiver_loses_state_and_delays_no_other(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        await world.peer("p")
        seen: list[BusSample] = []
        await b.subscribe("t/in", lambda sample: seen.append(sample) if sample.payload == b"last" else None)
        await linked(a, b)
        world.hang("p")
        loop = asyncio.get_running_loop()
        slowest_s = 0.0
        for _ in range(200):
            for _ in range(20):
                before_s = loop.time()
                a.put("t/in", b"s" * 20_000)
                slowest_s = max(slowest_s, loop.time() - before_s)
            await asyncio.sleep(0.002)
        assert slowest_s < 0.5
        await until(lambda: a.backlog == 0)
        async with asyncio.timeout(LIMIT_S):
            while not seen:
                a.put("t/in", b"last")
                await asyncio.sleep(0.002)
        world.resume("p")
        async with asyncio.timeout(LIMIT_S):
            while await a.request("t/p/latest", b"", LIMIT_S) != b"last":
                a.put("t/in", b"last")
                await asyncio.sleep(0.002)
        assert int(await a.request("t/p/count", b"", LIMIT_S)) < 4000

    run(body)


def test_an_absent_server_is_detected_at_once(run: Run) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        async with asyncio.timeout(1.0):
            with pytest.raises(NoReply, match="t/unserved"):
                await a.request("t/unserved", b"", LIMIT_S)
            assert await a.request_all("t/unserved/*", b"", LIMIT_S) == {}

    run(body)


def test_a_hung_server_times_out_and_stays_present(run: Run) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        present: dict[str, bool] = {}
        await a.watch("t/live/*", present.__setitem__)
        await world.peer("p")
        await until(lambda: present == {"t/live/p": True})
        assert await a.request("t/p/echo", b"1", LIMIT_S) == b"p:1"
        world.hang("p")
        with pytest.raises(RequestTimeout, match=r"t/p/echo within 0\.3 s"):
            await a.request("t/p/echo", b"2", 0.3)
        assert present == {"t/live/p": True}
        world.resume("p")
        assert await a.request("t/p/echo", b"3", LIMIT_S) == b"p:3"

    run(body)


def test_the_text_of_a_refusal_travels(run: Run) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        await world.peer("p")
        with pytest.raises(RequestRefused, match=r"^p will not, whatever Jörg says$"):
            await a.request("t/p/refuse", "Jörg".encode(), LIMIT_S)

    run(body)


def test_the_first_valid_reply_counts(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")

        async def refuse(sample: BusSample) -> bytes:
            raise RequestRefused("not I")

        await b.serve("t/shared", refuse)
        await linked(a, b)
        with pytest.raises(RequestRefused, match="not I"):
            await a.request("t/shared", b"", LIMIT_S)
        await world.peer("p")
        await world.peer("q")
        assert await a.request("t/shared", b"1", LIMIT_S) in (b"p:1", b"q:1")
        world.hang("p")
        async with asyncio.timeout(LIMIT_S / 2):
            assert await a.request("t/shared", b"2", LIMIT_S) == b"q:2"

    run(body)


def test_only_the_reply_of_the_expected_server_counts(run: Run) -> None:
    """Whatever another process answers, and however early."""

    async def body(world: World) -> None:
        a, forger = await world.join("a"), await world.join("forger")
        doubled: list[str] = []
        a.report_double_answers(doubled.append)

        async def forge(_: BusSample) -> bytes:
            return b"forged"

        await world.peer("p")
        server = await find_only_server(a, "t/p/*", LIMIT_S)
        for key in ("t/p/echo", "t/p/refuse", "t/p/say"):
            await forger.serve(key, forge)
        await linked(a, forger)
        (servers,) = (await a.find_servers("t/p/echo", LIMIT_S)).values()
        assert server in servers
        assert len(servers) == 2
        for _ in range(20):
            assert await a.request("t/p/echo", b"1", LIMIT_S, server) == b"p:1"
        with pytest.raises(RequestRefused, match="p will not"):
            await a.request("t/p/refuse", b"", LIMIT_S, server)
        await until(lambda: {"t/p/echo", "t/p/refuse"} <= set(doubled))
        # One that hangs is waited for; one that has ended does not answer any more.
        world.hang("p")
        with pytest.raises(RequestTimeout):
            await a.request("t/p/echo", b"2", 0.3, server)
        world.kill("p")
        async with asyncio.timeout(LIMIT_S):
            while True:
                try:
                    await a.request("t/p/echo", b"3", 0.3, server)
                except OtherServer:
                    break
                except RequestTimeout:
                    await asyncio.sleep(0.002)

    run(body)


def test_servers_that_cannot_be_found(run: Run) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        with pytest.raises(NoReply, match="t/unserved"):
            await find_only_server(a, "t/unserved/*", LIMIT_S)
        await world.peer("p")
        await world.peer("q")
        assert (
            await find_only_server(a, "t/p/latest", LIMIT_S) in (await a.find_servers("t/shared", LIMIT_S))["t/shared"]
        )
        with pytest.raises(DoubleServer, match="2 processes answer on t/shared"):
            await find_only_server(a, "t/shared", LIMIT_S)
        world.hang("p")
        with pytest.raises(RequestTimeout):
            await find_only_server(a, "t/p/latest", 0.3)

    run(body)


def test_all_servers_of_a_key_are_queried(run: Run) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        await world.peer("p")
        await world.peer("q")
        assert await a.request_all("t/*/echo", b"1", LIMIT_S) == {"t/p/echo": b"p:1", "t/q/echo": b"q:1"}
        world.hang("q")
        assert await a.request_all("t/*/echo", b"2", 0.3) == {"t/p/echo": b"p:2"}

    run(body)


def test_a_wildcard_reads_values_and_gets_no_errors(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        commands: list[BusSample] = []

        async def execute(sample: BusSample) -> bytes:
            commands.append(sample)
            return b"executed"

        async def refuse(_: BusSample) -> bytes:
            raise RequestRefused("a payload is needed")

        async def answer(sample: BusSample) -> bytes:
            return sample.key.encode()

        await b.serve("t/cmd/*", execute)
        await b.serve("t/events", refuse)
        await linked(a, b)
        async with asyncio.timeout(LIMIT_S):
            assert await a.request_all("t/cmd/**", b"", 10 * LIMIT_S) == {}
            assert await a.request_all("t/events/**", b"", 10 * LIMIT_S) == {}
        await b.serve("t/value", answer)
        await linked(a, b)
        assert await a.request_all("t/**", b"", LIMIT_S) == {"t/value": b"t/value"}
        assert commands == []
        assert await a.request("t/cmd/go", b"", LIMIT_S) == b"executed"
        with pytest.raises(RequestRefused, match="a payload is needed"):
            await a.request("t/events", b"", LIMIT_S)

    run(body)


def test_requests_are_handled_concurrently(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        both = asyncio.Barrier(2)

        async def meet(sample: BusSample) -> bytes:
            await both.wait()
            return sample.key.encode()

        await b.serve("t/meet/*", meet)
        await linked(a, b)
        asked = [a.request(f"t/meet/{number}", b"", LIMIT_S) for number in range(2)]
        assert await asyncio.gather(*asked) == [b"t/meet/0", b"t/meet/1"]

    run(body)


def test_a_late_joiner_gets_the_last_value_by_a_query(run: Run) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        await world.peer("p")
        async with asyncio.timeout(LIMIT_S):
            while await a.request("t/p/latest", b"", LIMIT_S) != b"value":
                a.put("t/in", b"value")
                await asyncio.sleep(0.002)
        late = await world.join("late")
        assert await late.request("t/p/latest", b"", LIMIT_S) == b"value"

    run(body)


def test_presence_is_seen_from_declaration_to_death(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        await world.peer("early")
        changes: list[tuple[str, bool]] = []
        await a.watch("t/live/*", lambda key, present: changes.append((key, present)))
        await until(lambda: changes == [("t/live/early", True)])
        token = await b.announce("t/live/b")
        await until(lambda: changes[1:] == [("t/live/b", True)])
        await token.undeclare()
        await until(lambda: changes[2:] == [("t/live/b", False)])
        own = await a.announce("t/live/a")
        await until(lambda: changes[3:] == [("t/live/a", True)])
        await own.undeclare()
        await until(lambda: changes[4:] == [("t/live/a", False)])
        world.kill("early")
        await until(lambda: changes[5:] == [("t/live/early", False)])
        with pytest.raises(NoReply):
            await a.request("t/early/echo", b"", LIMIT_S)

    run(body)


def test_a_visible_server_can_be_queried(run: Run) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        present: dict[str, bool] = {}
        await a.watch("t/live/*", present.__setitem__)
        for name in ("p", "q", "r"):
            await world.peer(name)
            await until(lambda name=name: f"t/live/{name}" in present)
            assert await a.request(f"t/{name}/echo", b"", LIMIT_S) == f"{name}:".encode()

    run(body)


def test_a_partition_loses_everything_and_its_end_restores_all(run: Run) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        await world.peer("p")
        changes: list[bool] = []
        said: list[BusSample] = []
        await a.watch("t/live/p", lambda _, present: changes.append(present))
        await a.subscribe("t/p/said", said.append)
        await until(lambda: changes == [True])
        world.cut()
        a.put("t/in", b"lost")
        with pytest.raises(RequestTimeout):
            await a.request("t/p/echo", b"", 0.3)
        await until(lambda: changes == [True, False])
        with pytest.raises(RequestTimeout):
            await a.request("t/p/echo", b"", 0.3)
        world.heal()
        await until(lambda: changes == [True, False, True])
        assert await a.request("t/p/latest", b"", LIMIT_S) == b""
        async with asyncio.timeout(LIMIT_S):
            while not said:
                await a.request("t/p/say", b"again", LIMIT_S)
                await asyncio.sleep(0.002)
        a.put("t/in", b"new")
        await request_until(a, "t/p/latest", b"new")

    run(body)


def test_a_request_that_a_cut_interrupts_times_out(run: Run) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        await world.peer("p")
        assert await a.request("t/p/echo", b"", LIMIT_S) == b"p:"
        world.hang("p")
        asked = asyncio.ensure_future(a.request("t/p/echo", b"", 1.0))
        await asyncio.sleep(0.1)
        world.cut()
        with pytest.raises(RequestTimeout):
            await asked

    run(body)


def test_close_may_be_called_twice_and_ends_all(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        present: dict[str, bool] = {}
        await b.watch("t/live/a", present.__setitem__)
        await a.announce("t/live/a")
        await world.peer("p")
        await until(lambda: present == {"t/live/a": True})
        world.hang("p")
        asked = asyncio.ensure_future(a.request("t/p/echo", b"", LIMIT_S))
        await asyncio.sleep(0.05)
        await a.close()
        await a.close()
        with pytest.raises(BusClosed):
            await asked
        with pytest.raises(BusClosed):
            a.put("t/x", b"")
        with pytest.raises(BusClosed):
            await a.subscribe("t/x", print)
        await until(lambda: present == {"t/live/a": False})

    run(body)


def test_data_that_was_put_before_close_is_sent(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        got: list[BusSample] = []
        await b.subscribe("t/x", got.append)
        await linked(a, b)
        for _ in range(100):
            a.put("t/x", b"x" * 1000, Priority.EVENT)
        await a.close()
        await until(lambda: len(got) == 100)

    run(body)


@pytest.mark.parametrize("key", ["", "/a", "a/", "a//b", "a/b*", "a/*", "a?b", "a b"])
def test_a_malformed_key_is_refused(run: Run, key: str) -> None:
    async def body(world: World) -> None:
        a = await world.join("a")
        with pytest.raises(ValueError, match=r"key|chunk"):
            a.put(key, b"")
        with pytest.raises(ValueError, match=r"key|chunk"):
            await a.request(key, b"", 1.0)

    run(body)
