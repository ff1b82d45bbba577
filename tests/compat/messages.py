"""Messages as they are on the wire, one for each key: recorded from a virtual fleet at work, and the models that read them."""

# pyright: reportPrivateUsage=false

import asyncio
import json
from collections.abc import Callable, Iterable
from typing import Any, NamedTuple
from unittest.mock import patch

from cluster.test_bus_page import EXAMPLES, MORE, requests
from cluster.worlds import demo_job, job, run_fleet, virtual_demo_fleet

from orchestrator.bus.base import BusDeclaration, BusSample, Priority, RequestHandler, ServedGroup
from orchestrator.bus.memory.bus import MemoryBus
from orchestrator.bus.service_verbs import SERVICE_VERBS
from orchestrator.bus.states.frame import FrameHeader
from orchestrator.model.base import Model
from orchestrator.model.messages import (
    BatchReply,
    BatchRequest,
    KeptEstop,
    LeaderHeartbeat,
    TimeReply,
    TracePart,
    TraceRequest,
)
from orchestrator.model.state import ClockReply, ControllerInfo, EventsReply, EventsRequest
from orchestrator.monitor.recording.channels import find_channel
from orchestrator.runtime.virtual.fleet import VirtualFleet

MAX_BYTES = 20_000  # of a file; of the messages below this the longest one has the most fields
_SHORT = frozenset({"ctl", "job", "host", "virtual"})  # an id follows, and then the rest of the key
_LAST = frozenset({"alarm", "alarm-request", "kept-estop", "leads", "session"})  # an id ends the key
_ANSWERS: dict[str, type[Model]] = {
    "ctl.event": EventsReply,
    "ctl.clock": ClockReply,
    "ctl.info": ControllerInfo,
    "kept-estop": KeptEstop,
    "leads": LeaderHeartbeat,
    "time": TimeReply,
}
_FRAMES = ("host.states", "host.events")
"""Their messages are a header, which is kept, and lines, which are messages of other keys."""
_REQUESTS: dict[str, type[Model]] = {"ctl.event": EventsRequest, "ctl.trace": TraceRequest}


class GoldenName(NamedTuple):
    """What a file holds. key: with dots, without ids. part: `published`, `request` or `answer`."""

    key: str
    part: str


def name_key(key: str) -> str:
    """The key below the fleet's prefix, without its ids."""
    first, *rest = key.split("/")[3:]
    if first == "lease":
        return "lease.axis" if len(rest) == 2 else "lease"
    return ".".join([first, *(rest[1:] if first in _SHORT else [] if first in _LAST else rest)])


def find_model(name: GoldenName, verbs: dict[str, tuple[type[Model], type[Model]]]) -> type[Model] | None:
    """The model of a message; None: it has none. verbs: of controllers, request and reply."""
    family, _, verb = name.key.rpartition(".")
    if name.key in _FRAMES:
        return FrameHeader
    if name.part == "published":
        parts = name.key.split(".")
        middle = ["x"] if parts[0] in _SHORT | _LAST | {"lease"} else []
        return find_channel("/".join(["tutti", "v1", "f", parts[0], *middle, *parts[1:]])).model
    is_request = name.part == "request"
    if family == "svc":
        return SERVICE_VERBS[verb].request if is_request else SERVICE_VERBS[verb].reply
    if family == "ctl.cmd":
        return verbs[verb][0 if is_request else 1]
    if family == "host.cmd":
        return BatchRequest if is_request else BatchReply
    if name.key == "ctl.trace":
        return TraceRequest if is_request else TracePart
    if is_request:
        return _REQUESTS.get(name.key)
    return _ANSWERS.get(name.key) or find_model(GoldenName(name.key, "published"), verbs)


class MessageLog:
    """The longest message of each kind that is not too long for a file."""

    def __init__(self) -> None:
        self.found: dict[GoldenName, bytes] = {}

    def add(self, key: str, part: str, payload: bytes) -> None:
        if not payload.startswith(b"{") or key.split("/")[3] == "log":
            return  # a line of a log has no model
        name = GoldenName(name_key(key), part)
        if name.key in _FRAMES and part != "request":
            payload, *lines = payload.split(b"\n")
            for line, text in zip(json.loads(payload)["lines"], lines, strict=True):
                self.add(f"tutti/v1/f/ctl/{line}", part, text)
        known = self.found.get(name)
        if name.key.startswith("host.cmd.") and part != "published":
            self._add_inner(name, payload)
            name = GoldenName("host.cmd.VERB", part)
            known = self.found.get(name)
        better = known is None or (len(payload) <= MAX_BYTES and not len(payload) <= len(known) <= MAX_BYTES)
        if better:
            self.found[name] = payload

    def _add_inner(self, name: GoldenName, payload: bytes) -> None:
        """The requests, or replies, of the controllers in one of a host."""
        field = "requests" if name.part == "request" else "replies"
        verb = name.key.rpartition(".")[2]
        leaf = verb if verb == "info" else f"cmd/{verb}"  # a value, asked for of several
        for controller, text in json.loads(payload).get(field, {}).items():
            self.add(f"tutti/v1/f/ctl/{controller}/{leaf}", name.part, text.encode())


class LoggedGroup:
    """A group whose answers are logged."""

    def __init__(self, group: ServedGroup, log_answers: Callable[[RequestHandler], RequestHandler]) -> None:
        self._group, self._log_answers = group, log_answers

    def find_handler(self, key: str) -> RequestHandler | None:
        handler = self._group.find_handler(key)
        return None if handler is None else self._log_answers(handler)

    def list_values(self) -> Iterable[str]:
        return self._group.list_values()


def record_messages() -> dict[GoldenName, bytes]:
    """What goes over the bus of the demo fleet while it works, by kind; the same at each call."""
    log = MessageLog()
    put, serve, serve_group = MemoryBus.put, MemoryBus.serve, MemoryBus.serve_group

    def put_and_log(self: MemoryBus, key: str, payload: bytes, priority: Priority = Priority.STATE) -> None:
        log.add(key, "published", payload)
        put(self, key, payload, priority)

    def log_answers(handler: Callable[..., Any]) -> RequestHandler:
        async def answer_and_log(sample: BusSample) -> bytes:
            answer: bytes = await handler(sample)
            log.add(sample.key, "request", sample.payload)
            log.add(sample.key, "answer", answer)
            return answer

        return answer_and_log

    async def serve_and_log(self: MemoryBus, expression: str, handler: Callable[..., Any]) -> BusDeclaration:
        return await serve(self, expression, log_answers(handler))

    async def serve_group_and_log(self: MemoryBus, expression: str, group: ServedGroup) -> BusDeclaration:
        return await serve_group(self, expression, LoggedGroup(group, log_answers))

    with (
        patch.object(MemoryBus, "put", put_and_log),
        patch.object(MemoryBus, "serve", serve_and_log),
        patch.object(MemoryBus, "serve_group", serve_group_and_log),
    ):
        run_fleet(_work, virtual_demo_fleet())
    return dict(sorted(log.found.items()))


async def _work(fleet: VirtualFleet) -> None:
    client = fleet.make_client()
    assert (await client.wait_for_job(await client.submit(demo_job()))).state == "done"
    triggers = "triggers: [{output: gantry.lamp, every: 50 ms}]"
    sampled = job(f"[{{do: move, by: {{gantry.x: 5}}, record: {{axes: [gantry.x], period: 5 ms}}, {triggers}}}]")
    assert (await client.wait_for_job(await client.submit(sampled))).state == "done"
    probe = "{do: probe, name: EDGE, to: {gantry.y: 101}, until: gantry.touch, speed: 10 mm/s, else: continue}"
    measured = job(f"[{{do: move, to: {{gantry.y: 100}}}}, {probe}, {{do: set-position, axes: {{gantry.y: 0}}}}]")
    assert (await client.wait_for_job(await client.submit(measured))).state == "done"
    async with client.live("gantry.x") as live:
        await live.move(by={"gantry.x": -1})
    for number, (key, fields, _) in enumerate(requests()):
        request = {name: EXAMPLES[name] for name in fields if name in EXAMPLES}
        request |= {"request_id": f"r{number}"} if "request_id" in fields else {}
        if "job" in fields:
            request["job"] = json.loads(job("[{do: dwell, duration: 0.1 s}]").to_json())
        if "configuration" in fields:
            request["configuration"] = virtual_demo_fleet().to_plain()
        request |= MORE.get(key, {})
        payload = json.dumps(request).encode() if fields else b""
        await client.bus.request(f"{client.keys.prefix}/{key}".replace("{id}", "gantry"), payload, 30.0)
    await client.bus.request_all(client.keys.leader_answer(), b"", 1.0)
    await client.bus.request_all(client.keys.host_states(), b"", 1.0)
    await client.estop("golden")
    await asyncio.sleep(1.0)
    await client.bus.request_all(client.keys.kept_estop(), b"", 1.0)
    await client.reset()
    await asyncio.sleep(1.0)


def find_verbs() -> dict[str, tuple[type[Model], type[Model]]]:
    """The verbs of controllers, with the models of request and reply."""

    async def main(fleet: VirtualFleet) -> dict[str, tuple[type[Model], type[Model]]]:
        (unit, *_) = fleet.adapter_hosts["local"].supervisors.values()
        return {verb: (request, reply) for verb, (request, reply, _) in unit._commands._verbs.items()}

    return run_fleet(main)
