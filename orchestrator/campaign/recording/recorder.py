"""A recorder of the requests of coordinators to adapters, and of the replies: it shows the stage of a step, and each
promise."""

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import chain
from typing import Any, Literal, get_args

from orchestrator.bus.base import BusDeclaration, BusSample, Priority, RequestHandler, ServedGroup
from orchestrator.bus.memory.bus import MemoryBus
from orchestrator.campaign.recording.row_recorder import RowRecorder
from orchestrator.campaign.recording.start_recorder import StartRecorder
from orchestrator.clock.base import Clock

Stage = Literal[
    "jog",
    "home",
    "propose",
    "arm",
    "commit",
    "go",
    "fire",
    "motion",
    "chain",
    "chunk",
    "trigger",
    "at-once",
    "live",
    "armed-waiting",
    "flying",
    "virtual",
    "pair",
    "probe",
    "zone",
]
"""chain: a step is loaded behind a moving one, and has not been moving for long. Stages with seeds of their own: chunk:
the next chunk of a path is loaded or released; trigger: a step moves whose members switch outputs on the way; at-once:
a step that starts at once is requested, and waits for the end of the one before; live: a step that a live job was asked
for is loaded behind a moving one, or moves; armed-waiting: a step is armed, and waits for `go`;
flying: several lines of a scan are flown in one motion; virtual: a step of virtual axes moves; pair: two axes that
carry one beam move; probe: an axis moves until it is stopped by an input;
zone: axes that carry bodies of keep-out zones move."""
_ALL: tuple[Stage, ...] = get_args(Stage)
_CHAIN = _ALL.index("chain")
STAGES = _ALL[: _CHAIN + 1]
STATED_STAGES = _ALL[_CHAIN:]
"""Those that the requests of a step alone do not show: a fault that was drawn for one of them counts for it."""

SEARCHES: tuple[Stage, ...] = ("home", "probe")
"""The requests by which an axis moves until it finds something; each is a stage of its own."""
_RECORDED_VERBS = (
    *("lease", *SEARCHES, "propose", "arm", "commit", "go"),
    *("load-chunk", "release-chunk", "start-at-once"),
)


@dataclass(slots=True)
class RecordedRequest:
    """One request to an adapter, about a lease or a step. Instants in host ns; answered_ns: None without a reply.

    fields: those of the request, without profiles.
    accepted: whether the adapter accepted.
    """

    verb: str
    member: str
    fields: dict[str, Any]
    sent_ns: int
    answered_ns: int | None = None
    accepted: bool = False
    reply: dict[str, Any] = field(default_factory=dict[str, Any])

    @property
    def job_id(self) -> str:
        """The job of the request; requests for homing or a lease name it as their holder."""
        return self.fields["job"] if "job" in self.fields else self.fields["holder"]

    @property
    def step_id(self) -> tuple[str, int]:
        """The job and the index of its step; a homing counts as the first one."""
        return self.job_id, self.fields.get("step", 0)

    @property
    def promise_terms(self) -> tuple[str, int, int, str, int]:
        """Job, step, epoch, coordinator and T0: these must be equal for all members."""
        fields = self.fields
        return fields["job"], fields["step"], fields["epoch"], fields["coordinator"], fields["t0_fleet_ns"]


class BusRecorder:
    """Records every request of every coordinator of a fleet. `on_request` is called when a request is sent, and when it
    is answered.

    first_arms_ns: when the first arm request of each step was sent, host ns.
    preceding_t0_ns: T0 of the last step before this one that a member was started for to move the same axis, fleet ns;
    by step, member and axis, and by the T0 of this one: a step that was interrupted has several. A member without axes
    only drives a trigger line."""

    def __init__(self, clock: Clock, on_request: Callable[[RecordedRequest], None]) -> None:
        self.requests: list[RecordedRequest] = []
        self.starts = StartRecorder(clock)
        self.rows = RowRecorder()
        self.first_arms_ns: dict[tuple[str, int], int] = {}
        self.preceding_t0_ns: dict[tuple[tuple[str, int], str, str], dict[int, int]] = {}
        self._armed_axes: dict[tuple[tuple[str, int], str], list[str]] = {}
        self._started: dict[tuple[str, str], list[tuple[tuple[str, int], int]]] = {}
        self._by_verb: dict[str, list[RecordedRequest]] = {}
        self._clock = clock
        self._on_request = on_request

    def find_requests(self, verb: str) -> Iterator[RecordedRequest]:
        """Return all requests of one verb, in order."""
        return iter(self._by_verb.get(verb, ()))

    def find_searches(self) -> Iterator[RecordedRequest]:
        """Return all requests by which axes search, by their verbs."""
        return chain.from_iterable(map(self.find_requests, SEARCHES))

    def find_armed_axes(self, step: tuple[str, int], member: str) -> Sequence[str]:
        """Return the axes that a member was armed to move in a step; none for one that only drives a trigger line."""
        return self._armed_axes.get((step, member), ())

    def wrap_bus(self, bus: MemoryBus) -> "RecordedBus":
        """Wrap the `bus` of a coordinator."""
        return RecordedBus(bus, self)

    def record_requests(self, key: str, payload: bytes) -> list[RecordedRequest]:
        """Record a request to one member, or to several of a host."""
        *_, kind, name, cmd, verb = ["", "", "", *key.split("/")]
        if cmd != "cmd" or verb not in _RECORDED_VERBS:
            return []
        texts = json.loads(payload)["requests"] if kind == "host" else {name: payload}
        return [self._record_request(verb, member, json.loads(text)) for member, text in texts.items()]

    def _record_request(self, verb: str, member: str, fields: dict[str, Any]) -> RecordedRequest:
        axes = fields.pop("profiles", None)
        if axes is not None:
            fields["axes"] = list(axes)
        asked_request = RecordedRequest(verb, member, fields, self._clock.now_ns())
        self.requests.append(asked_request)
        self._by_verb.setdefault(verb, []).append(asked_request)
        if verb == "start-at-once":
            # It is an arming and a release; the instant of its decision stands for T0 until the member has chosen that.
            fields["t0_fleet_ns"] = fields["decided_fleet_ns"]
            for part in ("arm", "go"):
                self._by_verb.setdefault(part, []).append(asked_request)
        if verb in ("arm", "start-at-once"):
            self.first_arms_ns.setdefault(asked_request.step_id, asked_request.sent_ns)
            self._armed_axes[asked_request.step_id, member] = asked_request.fields["axes"]
        if verb == "go":
            self._note_preceding(asked_request)
        self._on_request(asked_request)
        return asked_request

    def _note_preceding(self, go: RecordedRequest) -> None:
        """Note the T0 of the step before this one, for each axis that the member moves. A step that was withdrawn may
        have been meant to begin later than the one after it: it is not before that one."""
        step, t0_ns = go.step_id, go.fields["t0_fleet_ns"]
        for axis in self.find_armed_axes(step, go.member):
            starts = self._started.setdefault((go.member, axis), [])
            before_ns = next((ns for step_id, ns in reversed(starts) if step_id != step and ns < t0_ns), None)
            if before_ns is not None:
                self.preceding_t0_ns.setdefault((step, go.member, axis), {})[t0_ns] = before_ns
            starts.append((step, t0_ns))

    def record_replies(self, key: str, requests: list[RecordedRequest], payload: bytes) -> None:
        """Record the reply, for all members that answered."""
        is_batch = key.split("/")[3] == "host"
        texts = json.loads(payload)["replies"] if is_batch else {request.member: payload for request in requests}
        for request in requests:
            if request.member in texts:
                request.answered_ns = self._clock.now_ns()
                request.reply = json.loads(texts[request.member])
                request.accepted = request.reply["refused"] is None
                if request.verb == "start-at-once" and request.accepted:
                    request.fields["t0_fleet_ns"] = request.reply["t0_fleet_ns"]
                    self._note_preceding(request)
                self._on_request(request)


class RecordedBus:
    """The bus of a coordinator, with a recorder."""

    def __init__(self, bus: MemoryBus, recorder: BusRecorder) -> None:
        self._bus = bus
        self._recorder = recorder

    async def request(self, key: str, payload: bytes, timeout_s: float, server: str | None = None) -> bytes:
        asked_requests = self._recorder.record_requests(key, payload)
        reply = await self._bus.request(key, payload, timeout_s, server)
        if asked_requests:
            self._recorder.record_replies(key, asked_requests, reply)
        return reply

    def put(self, key: str, payload: bytes, priority: Priority = Priority.STATE) -> None:
        self._recorder.starts.note_publication(key, payload)
        self._recorder.rows.note_publication(key, payload)
        self._bus.put(key, payload, priority)

    async def subscribe(
        self, expression: str, callback: Callable[[BusSample], None], *, direct: bool = False
    ) -> BusDeclaration:
        return await self._bus.subscribe(expression, callback, direct=direct)

    async def serve(self, expression: str, handler: RequestHandler) -> BusDeclaration:
        return await self._bus.serve(expression, self._recorder.starts.watch_handler(expression, handler))

    async def serve_group(self, expression: str, group: ServedGroup) -> BusDeclaration:
        return await self._bus.serve_group(expression, group)

    async def request_all(self, expression: str, payload: bytes, timeout_s: float) -> dict[str, bytes]:
        return await self._bus.request_all(expression, payload, timeout_s)

    async def find_servers(self, expression: str, timeout_s: float) -> dict[str, set[str]]:
        return await self._bus.find_servers(expression, timeout_s)

    async def announce(self, key: str) -> BusDeclaration:
        return await self._bus.announce(key)

    async def watch(self, expression: str, callback: Callable[[str, bool], None]) -> BusDeclaration:
        return await self._bus.watch(expression, callback)

    async def watch_subscribers(self, expression: str, callback: Callable[[bool], None]) -> BusDeclaration:
        return await self._bus.watch_subscribers(expression, callback)

    def report_double_answers(self, callback: Callable[[str], None]) -> None:
        self._bus.report_double_answers(callback)

    @property
    def backlog(self) -> int:
        return self._bus.backlog

    async def close(self) -> None:
        await self._bus.close()
