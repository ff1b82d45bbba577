"""A gateway in virtual time, and clients of it that speak ASGI instead of TCP."""

import asyncio
import json
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, ClassVar
from urllib.parse import unquote

from argon2 import PasswordHasher
from cluster.worlds import run_fleet

from orchestrator.bus.log import ProcessLog
from orchestrator.client.api import Tutti
from orchestrator.clock.executor import run_inline
from orchestrator.clock.virtual import VirtualProcess
from orchestrator.gateway.access import users as users_module
from orchestrator.gateway.access.roles import Role
from orchestrator.gateway.access.users import UserFile
from orchestrator.gateway.app import Gateway, GatewayOptions
from orchestrator.gateway.stream.merge_patch import apply_patch
from orchestrator.model.fleet import Fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

# The least work for each password: tests have many of them.
users_module._HASHER = PasswordHasher(time_cost=1, memory_cost=8, parallelism=1)

PORT = 8080
PASSWORD = "correct horse"
OWN = {"host": f"127.0.0.1:{PORT}"}
WAIT_S = 10.0

Headers = Mapping[str, str]


@dataclass
class Answer:
    """An answer to a request."""

    status: int
    headers: dict[str, str]
    body: bytes
    set_cookies: list[str] = field(default_factory=list)

    @property
    def cookies(self) -> dict[str, tuple[str, ...]]:
        """The cookies that it sets: value, and attributes in the order of their names."""
        parts = [[part.strip() for part in cookie.split(";")] for cookie in self.set_cookies]
        return {first.partition("=")[0]: (first.partition("=")[2], *sorted(more)) for first, *more in parts}

    @property
    def json(self) -> Any:
        return json.loads(self.body)

    @property
    def refused(self) -> str:
        """The code of the refusal; empty if it is none."""
        value = self.json
        return (value.get("refused") or {}).get("code", "") if isinstance(value, dict) else ""


@dataclass
class Socket:
    """An open socket. `state` is what a page makes of the stream."""

    frames: list[dict[str, Any]] = field(default_factory=list)
    state: dict[str, Any] = field(default_factory=dict)
    number: int | None = None
    whole: int = 0  # states that arrived as a whole
    gaps: int = 0
    closed: int | None = None
    reads: bool = True
    denied: Answer | None = None
    sent: int = 0
    _inwards: asyncio.Queue[dict[str, Any]] = field(default_factory=asyncio.Queue)
    _changed: asyncio.Event = field(default_factory=asyncio.Event)
    _next: int = 0

    def send(self, do: str, **fields: Any) -> int:
        """Send a frame; its id."""
        self._next += 1
        self.send_text(json.dumps({"do": do, "id": self._next, **fields}))
        return self._next

    def send_text(self, text: str) -> None:
        self._inwards.put_nowait({"type": "websocket.receive", "text": text})

    def close(self) -> None:
        """Close it, as a page that is gone does."""
        self._inwards.put_nowait({"type": "websocket.disconnect", "code": 1001})

    async def ask(self, do: str, **fields: Any) -> dict[str, Any]:
        """Send a frame, and wait for its answer."""
        number = self.send(do, **fields)
        return await self.wait_for(lambda: self.find(answer=number))

    def find(self, **fields: Any) -> dict[str, Any] | None:
        """The newest frame with these fields."""
        return next((each for each in reversed(self.frames) if each.items() >= fields.items()), None)

    def find_kind(self, name: str) -> Any:
        """The newest frame of a kind: its value."""
        return next((each[name] for each in reversed(self.frames) if name in each), None)

    async def wait_for(self, find: Callable[[], Any], limit_s: float = WAIT_S) -> Any:
        """Wait until `find` finds something."""
        async with asyncio.timeout(limit_s):
            while not (found := find()):
                self._changed.clear()
                await self._changed.wait()
        return found

    async def receive(self) -> dict[str, Any]:
        return await self._inwards.get()

    async def take(self, message: dict[str, Any]) -> None:
        """A message of the gateway."""
        while not self.reads:
            await asyncio.sleep(0.01)
        if message["type"] == "websocket.send":
            self._take_frame(json.loads(message["text"]))
            self.sent += len(message["text"])
        elif message["type"] == "websocket.close":
            self.closed = message.get("code", 1000)
            self._inwards.put_nowait({"type": "websocket.disconnect", "code": self.closed})
        elif message["type"] == "websocket.http.response.start":
            self.denied = Answer(message["status"], {}, b"")
        elif message["type"] == "websocket.http.response.body":
            assert self.denied is not None
            self.denied.body += message["body"]
        self._changed.set()

    def _take_frame(self, frame: dict[str, Any]) -> None:
        if "state" in frame:
            self.state, self.number, self.whole = frame["state"], frame["n"], self.whole + 1
        elif "patch" in frame:
            self.gaps += frame["n"] != (self.number or 0) + 1
            self.state, self.number = apply_patch(self.state, frame["patch"]), frame["n"]
        else:
            self.frames.append(frame)


def run_with_gateway(main: Callable[[VirtualFleet], Coroutine[Any, Any, None]], file: Fleet | None = None) -> None:
    """Run `main` with a started virtual fleet, and end its gateways: what a socket has begun ends in its own loop."""

    async def run(fleet: VirtualFleet) -> None:
        try:
            await main(fleet)
        finally:
            for gateway in VirtualGateway.started:
                await gateway.close()
            VirtualGateway.started.clear()

    run_fleet(run, file)


class VirtualGateway:
    """The gateway of a virtual fleet, in a process of its own. roles: its users, each with `PASSWORD`. names: by which
    other computers reach it, by TLS."""

    started: ClassVar[list["VirtualGateway"]] = []

    def __init__(
        self,
        fleet: VirtualFleet,
        folder: Path,
        roles: Mapping[str, Role] | None = None,
        names: Sequence[str] = (),
    ) -> None:
        self.fleet = fleet
        self.lines: list[str] = []
        self.sockets: list[Socket] = []
        self.users = UserFile(folder / "users.json")
        for name, role in (roles or {}).items():
            self.users.add_user(name, role, PASSWORD, "2026-01-01T00:00:00.000000Z")
        self.process = VirtualProcess(fleet.clock.loop, "gateway")
        bus = fleet.net.join_process("gateway")
        self.process.add_death_callback(lambda: fleet.net.kill_process("gateway"))
        log = ProcessLog("gateway", "test", fleet.clock, self.lines.append)
        folders = {"jobs": folder, "recordings": folder, "page": folder / "page"}
        options = GatewayOptions(PORT, self.users.path, fleet.draw_id, **folders, secure=bool(names), names=names)
        tutti = Tutti(bus, fleet.fleet.fleet, "gateway", fleet.draw_id)
        self.gateway = self.process.run_inside(lambda: Gateway(tutti, fleet.clock, log, run_inline, options))

    async def start(self) -> None:
        self.started.append(self)
        await self._run_inside(self.gateway.start())

    async def close(self) -> None:
        """End it, with its sockets, unless it was killed."""
        for socket in self.sockets:
            socket.reads = True
        if self.process.alive:
            await self._run_inside(self.gateway.close())
            await asyncio.sleep(3.0)  # for the leases of its sockets

    async def request(self, method: str, path: str, body: Any = None, headers: Headers | None = None) -> Answer:
        """Send a request. body: bytes, or what is sent as JSON."""
        data = body if isinstance(body, bytes) else b"" if body is None else json.dumps(body).encode()
        given = {**OWN, "content-type": "application/json", "content-length": str(len(data)), **(headers or {})}
        parts = [{"type": "http.request", "body": data, "more_body": False}]
        answer = Answer(0, {}, b"")

        async def receive() -> dict[str, Any]:
            return parts.pop(0) if parts else {"type": "http.disconnect"}

        async def send(message: dict[str, Any]) -> None:
            if message["type"] == "http.response.start":
                answer.status = message["status"]
                answer.set_cookies = [value.decode() for name, value in message["headers"] if name == b"set-cookie"]
                answer.headers = {name.decode().lower(): value.decode() for name, value in message["headers"]}
            else:
                answer.body += message.get("body", b"")

        scope = _make_scope("http", path, given) | {"method": method, "scheme": "http"}
        await self._run_inside(self.gateway.app(scope, receive, send))  # pyright: ignore[reportArgumentType]
        assert answer.status != 500, self.lines[-1]
        return answer

    async def get(self, path: str, headers: Headers | None = None) -> Answer:
        return await self.request("GET", path, None, headers)

    async def post(self, path: str, body: Any = None, headers: Headers | None = None) -> Answer:
        return await self.request("POST", path, {} if body is None else body, headers)

    async def sign_in(self, user: str, password: str = PASSWORD) -> dict[str, str]:
        """The headers of a session of `user`."""
        answer = await self.post("/v1/login", {"user": user, "password": password})
        assert answer.status == 200, answer.body
        return {"cookie": answer.headers["set-cookie"].partition(";")[0], "x-tutti-csrf": answer.json["csrf"]}

    async def connect(self, headers: Headers | None = None, path: str = "/v1/stream") -> Socket:
        """Open a socket, and wait for the state, or the refusal."""
        socket = Socket()
        self.sockets.append(socket)
        socket._inwards.put_nowait({"type": "websocket.connect"})
        scope = _make_scope("websocket", path, {**OWN, **(headers or {})})
        scope |= {"scheme": "ws", "subprotocols": [], "extensions": {"websocket.http.response": {}}}
        work = self.gateway.app(scope, socket.receive, socket.take)  # pyright: ignore[reportArgumentType]
        self.process.start_task(_ignore_result(work))
        await socket.wait_for(lambda: socket.state or socket.denied or socket.closed)
        return socket

    async def _run_inside(self, work: Coroutine[Any, Any, Any]) -> None:
        done: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        async def run() -> None:
            try:
                await work
            except Exception as error:
                done.set_exception(error)
            else:
                done.set_result(None)

        self.process.start_task(run())
        await done


async def _ignore_result(work: Awaitable[Any]) -> None:
    await work


def _make_scope(kind: str, path: str, headers: Headers) -> dict[str, Any]:
    plain, _, query = path.partition("?")
    return {
        "type": kind,
        "asgi": {"version": "3.0", "spec_version": "2.4"},
        "http_version": "1.1",
        "server": ("127.0.0.1", PORT),
        "client": ("127.0.0.1", 50_000),
        "root_path": "",
        "path": unquote(plain),
        "raw_path": plain.encode(),
        "query_string": query.encode(),
        "headers": [(name.lower().encode(), value.encode()) for name, value in headers.items()],
        "state": {},
    }
