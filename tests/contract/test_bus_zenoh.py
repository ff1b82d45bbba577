"""Faults that only the live bus can have: endpoints, routers that stand still, callbacks of a faulty program."""

import asyncio
import gc
import socket
import subprocess
import sys
import threading
import weakref
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import pytest
import zenoh

sys.path.insert(0, str(Path(__file__).parent))

from bus_worlds import LIMIT_S, LiveWorld, linked, run_live, until

from orchestrator.bus.base import BusSample, NoReply, Priority, RequestRefused, RequestTimeout
from orchestrator.bus.limits import MAX_ANSWERING, MAX_MESSAGE_BYTES
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.bus.zenoh.sessions import RouterRefused, RouterUnreachable, open_router, open_session
from orchestrator.bus.zenoh.threads import run_in_thread

FLOOD = 1000
"""Samples of 60 kB that the kernel's socket buffers surely do not hold."""

pytestmark = pytest.mark.live


def test_an_absent_router_is_named_with_the_remedy() -> None:
    endpoint = LiveWorld().endpoint
    with pytest.raises(RouterUnreachable, match=rf"{endpoint} within 0\.2 s; start one there"):
        asyncio.run(open_bus(endpoint, timeout_s=0.2))


def test_a_router_that_is_still_being_started_is_waited_for() -> None:
    async def body(world: LiveWorld) -> None:
        world.cut()
        joining = asyncio.ensure_future(world.join("a"))
        await asyncio.sleep(0.2)
        world.heal()
        with pytest.raises(NoReply):
            await (await joining).request("t/unserved", b"", LIMIT_S)

    run_live(body)


def test_a_taken_endpoint_is_named_with_the_remedy() -> None:
    async def body(world: LiveWorld) -> None:
        with pytest.raises(
            RouterRefused, match=f"{world.endpoint}: it is in use by another process. Stop that one, or choose"
        ):
            open_router(world.endpoint)

    run_live(body)


@pytest.mark.parametrize("endpoint", ["tcp/0.0.0.0:7447", "tcp/192.0.2.1:7447"])
def test_plain_tcp_is_for_this_host_alone(endpoint: str) -> None:
    with pytest.raises(RouterRefused, match="without TLS"):
        open_router(endpoint)


FREE_S = 3.0
"""A call that waits for the router takes 5 s at least (Zenoh's wait before close); copies on a busy machine take about 1 s."""


def test_a_stopped_router_delays_nothing_but_itself() -> None:
    async def body(world: LiveWorld) -> None:
        a, b = await world.join("a"), await world.join("b")
        await b.subscribe("t/x", lambda _: None)
        await linked(a, b)
        loop = asyncio.get_running_loop()
        world.hang("router")
        began_s = loop.time()
        for _ in range(FLOOD):
            a.put("t/x", b"x" * 60_000, Priority.EVENT)
            a.put("t/x", b"x" * 60_000)
        assert loop.time() - began_s < FREE_S
        with pytest.raises(RequestTimeout):
            await a.request("t/y", b"", 0.3)
        assert a.backlog > 10
        began_s = loop.time()
        await a.close()
        assert loop.time() - began_s < FREE_S
        del a
        began_s = loop.time()
        gc.collect()
        assert loop.time() - began_s < FREE_S

    run_live(body)


@pytest.mark.nightly
def test_a_process_ends_although_its_router_is_stopped() -> None:
    program = """
import asyncio, os, signal, sys
from orchestrator.bus.base import Priority
from orchestrator.bus.zenoh.bus import open_bus

async def main():
    bus = await open_bus(sys.argv[1])
    await bus.subscribe("t/**", print)
    await bus.announce("t/live")
    os.kill(int(sys.argv[2]), signal.SIGSTOP)
    for _ in range(int(sys.argv[3])):
        bus.put("t/x", b"x" * 60_000, Priority.EVENT)
    await bus.close()

asyncio.run(main())
"""

    async def body(world: LiveWorld) -> None:
        command = [sys.executable, "-c", program, world.endpoint, str(world.pid("router")), str(FLOOD)]
        assert subprocess.run(command, timeout=10, check=False, capture_output=True).returncode == 0

    run_live(body)


def test_processes_that_leave_in_the_middle_end_cleanly() -> None:
    """One in ten of them ended by SIGABRT."""
    program = """
import asyncio, sys
from orchestrator.bus.zenoh import bus

bus.CLOSE_TIMEOUT_S = 0.003

async def main():
    opened = await bus.open_bus(sys.argv[1])
    for _ in range(300):
        opened.put("t/x", b"x" * 100)
    await opened.close()

asyncio.run(main())
"""

    async def body(world: LiveWorld) -> None:
        command = [sys.executable, "-c", program, world.endpoint]
        for _ in range(8):
            assert subprocess.run(command, timeout=LIMIT_S, check=False, capture_output=True).returncode == 0

    run_live(body)


def test_a_bus_has_no_threads_but_its_own() -> None:
    """A Zenoh thread that returns to Python while the interpreter ends kills the process by SIGABRT."""

    async def body(world: LiveWorld) -> None:
        before = set(threading.enumerate())
        bus = await world.join("a")
        await bus.subscribe("t/x", lambda _: None)
        names = {thread.name for thread in set(threading.enumerate()) - before}
        assert names <= {"bus-state", "bus-events", "bus-open", "bus-declare"}

    run_live(body)


def test_an_object_used_off_the_loop_is_dropped_before_its_waiter_continues(monkeypatch: pytest.MonkeyPatch) -> None:
    """The last owner of a session must not drop it while the interpreter ends, for the same reason."""

    class Call:
        def __call__(self) -> None:
            pass

    async def main() -> None:
        call = Call()
        let_go = weakref.ref(call)
        made = run_in_thread("call", call)
        del call
        loop = asyncio.get_running_loop()
        wake, held = loop.call_soon_threadsafe, list[bool]()

        def note(callback: Callable[..., object], *values: object) -> None:
            held.append(let_go() is not None)
            wake(callback, *values)

        monkeypatch.setattr(loop, "call_soon_threadsafe", note)
        await made
        assert held == [False]

    asyncio.run(main())


def test_a_fault_of_a_handler_is_answered_and_reported() -> None:
    async def body(world: LiveWorld) -> None:
        a = await world.join("a")
        reported: list[dict[str, Any]] = []
        asyncio.get_running_loop().set_exception_handler(lambda _, context: reported.append(context))

        async def fail(sample: BusSample) -> bytes:
            raise KeyError("axis")

        def stumble(sample: BusSample) -> None:
            raise KeyError(sample.key)

        got: list[BusSample] = []
        await a.subscribe("t/x", stumble)
        await a.subscribe("t/x", got.append)
        await a.serve("t/fail", fail)
        await linked(a, a)
        with pytest.raises(RequestRefused, match="KeyError while answering t/fail: 'axis'"):
            await a.request("t/fail", b"", LIMIT_S)
        a.put("t/x", b"")
        await until(lambda: len(got) == 1)
        assert [type(context["exception"]) for context in reported] == [KeyError, KeyError]

    run_live(body)


def test_a_declaration_stays_without_a_reference_to_it() -> None:
    async def body(world: LiveWorld) -> None:
        a, b = await world.join("a"), await world.join("b")
        got: list[object] = []
        await b.subscribe("t/x", got.append)
        await b.watch("t/live/*", lambda key, _: got.append(key))
        gc.collect()
        await linked(a, b)
        await a.announce("t/live/a")
        gc.collect()
        a.put("t/x", b"")
        await until(lambda: len(got) == 2)
        assert "t/live/a" in got

    run_live(body)


def test_huge_messages_are_left_out_and_the_sessions_continue() -> None:
    most = 4_000_000

    async def body(world: LiveWorld) -> None:
        host = await open_bus(world.endpoint, max_message_bytes=most)
        other = await world.join("other")
        got: list[tuple[str, int]] = []

        async def answer(sample: BusSample) -> bytes:
            return b"x" * len(sample.payload)

        await host.subscribe("t/**", lambda sample: got.append((sample.key, len(sample.payload))))
        await host.serve("t/cmd/*", answer)
        await linked(other, host)
        stranger = open_session(world.endpoint)
        try:
            for key, size in (("t/fits", most), ("t/large", most + 1), ("t/huge", MAX_MESSAGE_BYTES + 36_000_000)):
                put = partial(stranger.put, key, b"x" * size, congestion_control=zenoh.CongestionControl.BLOCK)
                await run_in_thread("put", put)
            # Also an e-stop that cannot be read is one.
            stranger.put("t/estop", b"x" * (most + 1), priority=zenoh.Priority.REAL_TIME)
            await until(lambda: ("t/estop", 0) in got and ("t/fits", most) in got)
            assert await other.request("t/cmd/do", b"x", LIMIT_S) == b"x"
            with pytest.raises(RequestRefused, match=f"at most {most} bytes"):
                await other.request("t/cmd/do", b"x" * (most + 1), LIMIT_S)
            with pytest.raises(RequestRefused, match="at most"):
                await other.request("t/cmd/do", b"x" * (MAX_MESSAGE_BYTES + 1), LIMIT_S)
            other.put("t/too-large", b"x" * (MAX_MESSAGE_BYTES + 1))
            other.put("t/after", b"", Priority.EVENT)
            await until(lambda: ("t/after", 0) in got)
            assert {key for key, _ in got} & {"t/large", "t/huge", "t/too-large"} == set()
        finally:
            await run_in_thread("close", stranger.close)
            await host.close()

    run_live(body)


def test_silent_connections_cost_a_new_session_two_seconds_at_most() -> None:
    async def body(world: LiveWorld) -> None:
        open_session_before = await world.join("before")
        host, port = world.endpoint.removeprefix("tcp/").split(":")
        silent = [socket.create_connection((host, int(port))) for _ in range(500)]
        try:
            loop = asyncio.get_running_loop()
            began_s = loop.time()
            late = await open_bus(world.endpoint, timeout_s=LIMIT_S)
            took_s = loop.time() - began_s
            sys.stdout.write(f"a session beside 500 silent connections: {took_s:.2f} s\n")
            assert took_s < 4.0  # 2 s, and a margin for a busy machine
            got: list[BusSample] = []
            await late.subscribe("t/x", got.append)
            await linked(open_session_before, late)
            await late.close()
        finally:
            for each in silent:
                each.close()

    run_live(body)


def test_requests_beyond_the_limit_are_refused_and_stops_are_not() -> None:
    async def body(world: LiveWorld) -> None:
        host, client = await world.join("host"), await world.join("client")
        go_on, begun = asyncio.Event(), list[str]()

        async def answer(sample: BusSample) -> bytes:
            begun.append(sample.key)
            if not sample.key.endswith("stop"):
                await go_on.wait()
            return b"done"

        await host.serve("t/cmd/*", answer)
        await linked(client, host)
        requests = [asyncio.ensure_future(client.request("t/cmd/home", b"", LIMIT_S)) for _ in range(MAX_ANSWERING)]
        await until(lambda: len(begun) == MAX_ANSWERING)
        with pytest.raises(RequestRefused, match="busy"):
            await client.request("t/cmd/home", b"", LIMIT_S)
        assert await client.request("t/cmd/stop", b"", LIMIT_S) == b"done"
        go_on.set()
        assert set(await asyncio.gather(*requests)) == {b"done"}
        assert await client.request("t/cmd/home", b"", LIMIT_S) == b"done"

    run_live(body)
