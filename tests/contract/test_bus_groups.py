"""Keys that are served by one declaration, and watches for subscribers: one contract over both buses."""

import sys
from collections.abc import Callable, Iterable
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).parent))

from bus_worlds import Body, World, linked, run_live, run_memory, until

from orchestrator.bus.base import BusSample, NoReply, RequestHandler, RequestRefused

Run = Callable[[Body], None]


@pytest.fixture(params=["memory", pytest.param("live", marks=pytest.mark.live)])
def run(request: pytest.FixtureRequest) -> Run:
    return run_memory if request.param == "memory" else run_live


class Group:
    """Serves values, and commands below `cmd`."""

    def __init__(self, values: dict[str, bytes]) -> None:
        self.values = values
        self.commands: list[str] = []

    def find_handler(self, key: str) -> RequestHandler | None:
        if "/cmd/" in key:
            return self._execute
        return self._answer if key in self.values else None

    def list_values(self) -> Iterable[str]:
        return list(self.values)

    async def _answer(self, sample: BusSample) -> bytes:
        if self.values[sample.key] == b"refused":
            raise RequestRefused("not now")
        return self.values[sample.key] + sample.payload

    async def _execute(self, sample: BusSample) -> bytes:
        self.commands.append(sample.key)
        return b"done"


def test_a_group_answers_for_each_of_its_keys_and_for_no_other(run: Run) -> None:
    async def body(world: World) -> None:
        a, b, c = await world.join("a"), await world.join("b"), await world.join("c")
        one, other = Group({"t/x/state": b"1", "t/y/state": b"2"}), Group({"t/z/state": b"3"})
        await a.serve_group("t/**", one)
        served = await b.serve_group("t/**", other)
        await linked(a, c)
        await linked(b, c)
        assert await c.request("t/x/state", b"?", 5.0) == b"1?"
        assert await c.request_all("t/*/state", b"", 5.0) == {"t/x/state": b"1", "t/y/state": b"2", "t/z/state": b"3"}
        with pytest.raises(NoReply):
            await c.request("t/other/state", b"", 5.0)
        one.values["t/other/state"] = b"4"  # served from now on, without another declaration
        assert await c.request("t/other/state", b"", 5.0) == b"4"
        servers = await c.find_servers("t/*/state", 5.0)
        assert servers.keys() == {"t/x/state", "t/y/state", "t/z/state", "t/other/state"}
        assert servers["t/x/state"] == servers["t/y/state"] != servers["t/z/state"]
        assert await c.find_servers("t/z/state", 5.0) == {"t/z/state": servers["t/z/state"]}
        await served.undeclare()
        assert set(await c.request_all("t/*/state", b"", 5.0)) == set(one.values)

    run(body)


def test_a_request_on_a_wildcard_executes_no_command_of_a_group(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        group = Group({"t/x/state": b"1", "t/y/state": b"refused"})
        await a.serve_group("t/**", group)
        await linked(a, b)
        assert await b.request_all("t/**", b"", 5.0) == {"t/x/state": b"1"}
        assert group.commands == []
        assert await b.request("t/x/cmd/stop", b"", 5.0) == b"done" and group.commands == ["t/x/cmd/stop"]
        with pytest.raises(RequestRefused, match="not now"):
            await b.request("t/y/state", b"", 5.0)

    run(body)


def test_a_watch_says_whether_any_process_subscribes(run: Run) -> None:
    async def body(world: World) -> None:
        a, b = await world.join("a"), await world.join("b")
        earlier = await b.subscribe("t/x/state", lambda _: None)
        await linked(a, b)
        said: list[bool] = []
        watch = await a.watch_subscribers("t/*/state", said.append)
        await until(lambda: said == [True])
        await earlier.undeclare()
        await until(lambda: said == [True, False])
        await b.subscribe("t/x/event", lambda _: None)  # another key
        await b.subscribe("t/**", lambda _: None)
        await until(lambda: said == [True, False, True])
        await b.close()
        await until(lambda: said == [True, False, True, False])
        await watch.undeclare()
        c = await world.join("c")
        await c.subscribe("t/x/state", lambda _: None)
        await linked(a, c)
        assert len(said) == 4

    run(body)
