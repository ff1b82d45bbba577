"""One open socket: sends the stream and the answers, and carries out the requests of its frames.

A frame is answered at once; a stop, and the end of a jog, are passed on before anything else. What the socket's user
has begun (manual control, a jog, a one-step job) ends with the socket, and when it has sent no frame for a second.
"""

import asyncio
import contextlib
import json
from collections import deque
from collections.abc import Callable, Coroutine, Mapping
from typing import Any, Protocol, cast

from pydantic import ValidationError
from starlette.websockets import WebSocket, WebSocketDisconnect

from orchestrator.clock.base import NS_PER_S, Clock
from orchestrator.clock.owner import TaskOwner, running
from orchestrator.gateway.access.identity import Identity
from orchestrator.gateway.access.refusals import describe_refusal
from orchestrator.gateway.stream.need import EVERYTHING, read_need
from orchestrator.gateway.stream.stream_view import StreamReader, encode
from orchestrator.model.errors import NoName, Refusal
from orchestrator.model.problems import first_error_text
from orchestrator.model.text.outside_text import show_text

MAX_FRAME_CHARS = 64_000
MAX_FRAMES_PER_S = 200
MAX_ID = 2**53
MAX_WAITING = 200  # answers that wait for a slow reader; then it is disconnected
SEND_S = 15.0  # a reader that takes nothing for so long is disconnected
SIGN_NS = NS_PER_S  # without a frame for so long, the user is no longer there
CLOSED_BY_POLICY, CLOSED_NOT_ALLOWED = 1008, 4401

Frame = Mapping[str, Any]
Handler = Callable[[Frame], Coroutine[Any, Any, dict[str, Any]]]


class SocketActs(Protocol):
    """What a socket can do in the fleet, by the verb of a frame; made for one socket."""

    handlers: Mapping[str, Handler]

    def end_jog(self) -> None:
        """Stop the jog, at once."""
        ...

    async def close(self) -> None:
        """End all that was begun."""
        ...


class UserSocket:
    """A socket that was accepted. `run` it until it ends."""

    def __init__(
        self, socket: WebSocket, reader: StreamReader, identity: Identity, clock: Clock, is_valid: Callable[[], bool]
    ) -> None:
        self.identity = identity
        self._socket, self._clock, self._is_valid = socket, clock, is_valid
        self._wake = asyncio.Event()
        self._reader = reader
        reader.wake = self._wake.set
        self._wake.set()
        self._own: Mapping[str, Handler] = {"need": self._choose}
        self._waiting: deque[str] = deque()
        self._tasks = TaskOwner()
        self._framed_ns = clock.now_ns()
        self._second, self._frames = -1, 0
        self._over = False

    @property
    def is_alive(self) -> bool:
        """Whether the user is still there: the socket is open, and has sent a frame in the last second."""
        return not self._over and self._clock.now_ns() - self._framed_ns < SIGN_NS

    def send(self, frame: Mapping[str, Any]) -> None:
        """Queue a frame that must not be lost. A reader that takes none of them is disconnected."""
        self._waiting.append(encode(frame))
        self._wake.set()

    async def run(self, acts: SocketActs) -> None:
        """Serve it until it ends, by either side."""
        try:
            async with running(self._send_frames()) as sending, running(self._receive_frames(acts)) as receiving:
                await asyncio.wait([sending, receiving], return_when=asyncio.FIRST_COMPLETED)
        finally:
            self._over = True
            self._reader.close()
            self._tasks.cancel_all()
            # What was begun ends before anything else is done.
            await acts.close()
        for task in (sending, receiving):
            error = task.exception() if task.done() and not task.cancelled() else None
            if error is not None and not isinstance(error, WebSocketDisconnect | TimeoutError | OSError):
                raise error

    async def disconnect(self, code: int, reason: str) -> None:
        """End it, with the reason for the other side."""
        self._over = True
        with contextlib.suppress(Exception):
            async with asyncio.timeout(1.0):
                await self._socket.close(code, reason)

    # Outwards

    async def _send_frames(self) -> None:
        while not self._over:
            await self._wake.wait()
            self._wake.clear()
            if len(self._waiting) > MAX_WAITING:
                return
            while self._waiting:
                await self._send_text(self._waiting.popleft())
            frame = self._reader.take_frame()
            if frame is not None:
                await self._send_text(frame)
                if not self._is_valid():
                    await self.disconnect(CLOSED_NOT_ALLOWED, "signed out")
                    return

    async def _send_text(self, text: str) -> None:
        async with asyncio.timeout(SEND_S):
            await self._socket.send_text(text)

    # Inwards

    async def _receive_frames(self, acts: SocketActs) -> None:
        while not self._over:
            text = await self._socket.receive_text()
            if not self._has_place():
                await self.disconnect(CLOSED_BY_POLICY, f"more than {MAX_FRAMES_PER_S} frames a second")
                return
            frame = _read_frame(text)
            if frame is None:
                await self.disconnect(
                    CLOSED_BY_POLICY, 'a frame is a JSON object with "do" and an integer "id", of at most 64 kB'
                )
                return
            self._framed_ns = self._clock.now_ns()
            self._handle_frame(frame, acts)

    def _has_place(self) -> bool:
        second = self._clock.now_ns() // NS_PER_S
        if second != self._second:
            self._second, self._frames = second, 0
        self._frames += 1
        return self._frames <= MAX_FRAMES_PER_S

    def _handle_frame(self, frame: Frame, acts: SocketActs) -> None:
        verb = frame["do"]
        if verb == "end-jog":
            acts.end_jog()
        elif verb == "resync":
            self._reader.forget()
        elif verb != "alive":
            self._tasks.spawn(self._answer(verb, frame, acts))

    async def _answer(self, verb: str, frame: Frame, acts: SocketActs) -> None:
        answer: dict[str, Any]
        try:
            answer = {"ok": await self._carry_out(verb, frame, acts)}
        except Refusal as error:
            answer = {"refused": describe_refusal(error)}
        except (NoName, ValidationError) as error:
            text = first_error_text(error) if isinstance(error, ValidationError) else str(error)
            answer = {"refused": describe_refusal(Refusal("bad-request", text, "see the frames of the socket"))}
        if "id" in frame:
            self.send({"answer": frame["id"], **answer})

    async def _carry_out(self, verb: str, frame: Frame, acts: SocketActs) -> dict[str, Any]:
        handlers = {**acts.handlers, **self._own}
        handler = handlers.get(verb)
        if handler is None:
            raise Refusal("bad-request", f"unknown frame {verb[:40]!r}", f"known: {', '.join(sorted(handlers))}")
        if not self._is_valid():
            raise Refusal("not-signed-in", "the session has ended", "sign in again")
        return await handler(frame)

    async def _choose(self, frame: Frame) -> dict[str, Any]:
        """What the stream is to show from now on; without `need`, everything."""
        self._reader.choose(read_need(frame["need"]) if "need" in frame else EVERYTHING)
        return {}


def _read_frame(text: str) -> Frame | None:
    """A frame; None if it is none."""
    if len(text) > MAX_FRAME_CHARS:
        return None
    try:
        value: object = json.loads(text)
    except (ValueError, RecursionError):
        return None
    if not isinstance(value, dict):
        return None
    verb, number = (cast(Frame, value).get(name, 0) for name in ("do", "id"))
    if not isinstance(verb, str) or type(number) is not int or abs(number) > MAX_ID:
        return None
    return cast(Frame, _show_texts(value) if "\\u" in text else value)


def _show_texts(value: Any) -> Any:
    """A decoded value whose texts can be sent on: a half of a pair of UTF-16, and other hidden characters, become
    visible escapes."""
    if isinstance(value, str):
        return show_text(value)
    if isinstance(value, list):
        return [_show_texts(item) for item in cast(list[Any], value)]
    if isinstance(value, dict):
        return {show_text(key): _show_texts(entry) for key, entry in cast(dict[str, Any], value).items()}
    return value
