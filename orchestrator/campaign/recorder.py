"""A recorder of the requests of coordinators to adapters, and of the replies: it shows the stage of a step, and each
promise."""

import json
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any, Literal

from orchestrator.bus.base import Declared, Handler, Priority, Sample
from orchestrator.bus.memory.bus import MemoryBus
from orchestrator.clock.base import Clock

Stage = Literal["jog", "home", "propose", "arm", "commit", "go", "fire", "motion"]
STAGES: tuple[Stage, ...] = ("jog", "home", "propose", "arm", "commit", "go", "fire", "motion")

_SEEN = ("lease", "home", "propose", "arm", "commit", "go")


@dataclass(slots=True)
class Asked:
    """One request to an adapter, about a lease or a step. Instants in host ns; answered_ns: None without a reply.

    said: the fields of the request, without profiles.
    taken: whether the adapter accepted.
    """

    verb: str
    member: str
    said: dict[str, Any]
    asked_ns: int
    answered_ns: int | None = None
    taken: bool = False
    reply: dict[str, Any] = field(default_factory=dict[str, Any])

    @property
    def job(self) -> str:
        """The job of the request; requests for homing or a lease name it as their holder."""
        return self.said["job"] if "job" in self.said else self.said["holder"]

    @property
    def step(self) -> tuple[str, int]:
        """The job and the index of its step; a homing counts as the first one."""
        return self.job, self.said.get("step", 0)

    @property
    def promise(self) -> tuple[str, int, int, str, int]:
        """Job, step, epoch, coordinator and T0: these must be equal for all members."""
        said = self.said
        return said["job"], said["step"], said["epoch"], said["coordinator"], said["t0_fleet_ns"]


class Witness:
    """Records every request of every coordinator of a fleet. `heard` is called when a request is sent, and when it
    is answered."""

    def __init__(self, clock: Clock, heard: Callable[[Asked], None]) -> None:
        self.asked: list[Asked] = []
        self._clock = clock
        self._heard = heard

    def of(self, verb: str) -> Iterator[Asked]:
        """Return all requests of one verb, in order."""
        return (each for each in self.asked if each.verb == verb)

    def beside(self, bus: MemoryBus) -> "WitnessedBus":
        """Wrap the `bus` of a coordinator."""
        return WitnessedBus(bus, self)

    def ask(self, key: str, payload: bytes) -> list[Asked]:
        """Record a request to one member, or to several of a host."""
        *_, kind, name, cmd, verb = ["", "", "", *key.split("/")]
        if cmd != "cmd" or verb not in _SEEN:
            return []
        texts = json.loads(payload)["requests"] if kind == "host" else {name: payload}
        return [self._ask(verb, member, json.loads(text)) for member, text in texts.items()]

    def _ask(self, verb: str, member: str, said: dict[str, Any]) -> Asked:
        axes = said.pop("profiles", None)
        if axes is not None:
            said["axes"] = list(axes)
        asked = Asked(verb, member, said, self._clock.now_ns())
        self.asked.append(asked)
        self._heard(asked)
        return asked

    def answer(self, key: str, asked: list[Asked], payload: bytes) -> None:
        """Record the reply, for all members that answered."""
        together = key.split("/")[3] == "host"
        texts = json.loads(payload)["replies"] if together else {each.member: payload for each in asked}
        for each in asked:
            if each.member in texts:
                each.answered_ns = self._clock.now_ns()
                each.reply = json.loads(texts[each.member])
                each.taken = each.reply["refused"] is None
                self._heard(each)


class WitnessedBus:
    """The bus of a coordinator, with a recorder."""

    def __init__(self, bus: MemoryBus, witness: Witness) -> None:
        self._bus = bus
        self._witness = witness

    async def request(self, key: str, payload: bytes, timeout_s: float) -> bytes:
        asked = self._witness.ask(key, payload)
        reply = await self._bus.request(key, payload, timeout_s)
        if asked:
            self._witness.answer(key, asked, reply)
        return reply

    def put(self, key: str, payload: bytes, priority: Priority = Priority.STATE) -> None:
        self._bus.put(key, payload, priority)

    async def subscribe(self, expression: str, callback: Callable[[Sample], None]) -> Declared:
        return await self._bus.subscribe(expression, callback)

    async def serve(self, expression: str, handler: Handler) -> Declared:
        return await self._bus.serve(expression, handler)

    async def request_all(self, expression: str, payload: bytes, timeout_s: float) -> dict[str, bytes]:
        return await self._bus.request_all(expression, payload, timeout_s)

    async def announce(self, key: str) -> Declared:
        return await self._bus.announce(key)

    async def watch(self, expression: str, callback: Callable[[str, bool], None]) -> Declared:
        return await self._bus.watch(expression, callback)

    @property
    def backlog(self) -> int:
        return self._bus.backlog

    async def close(self) -> None:
        await self._bus.close()
