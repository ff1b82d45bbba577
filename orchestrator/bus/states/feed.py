"""What all controllers of a fleet publish, for a process that follows many: from the frames of their hosts, and on the
keys of their own from hosts of protocol 1.5, which know no frames."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from orchestrator.bus.base import Bus, BusDeclaration, BusError, BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.states.frame import BadFrame, Confirmation, HostFrame, decode_frame
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.owner import TaskOwner

ASK_S = 1.0  # for a host to answer with all states
ASK_AGAIN_NS = 200 * NS_PER_MS
CARRIED_NS = 2 * NS_PER_S
"""A controller stays with the host that carries it until that one has been silent for so long: while it is there no
other host can publish in its place."""


class Arrival(NamedTuple):
    """What one message has brought. host: that has published it; empty for one without frames. samples: states, events,
    clock mappings and link totals, with the keys of their controllers, `ctl/{id}/{leaf}`. confirmations: of all
    controllers of the host, as of behind the samples; none where the message says nothing of them."""

    host: str
    samples: Sequence[BusSample]
    confirmations: Mapping[str, Confirmation]


class FeedReceiver(Protocol):
    """What takes the feed."""

    def take_arrival(self, arrival: Arrival) -> None:
        """Take what one message has brought."""
        ...

    def take_bad_frame(self, text: str) -> None:
        """A frame that cannot be read, or of a host that may not publish what is in it. text: why."""
        ...


@dataclass(slots=True)
class _KnownHost:
    """The frames of a host. number: of the last one. seqs: of the last state of each controller in a frame. asked_ns:
    when all its states were asked for last."""

    instance: str
    number: int
    seqs: dict[str, int]
    framed_ns: int
    asked_ns: int | None = None
    is_asking: bool = False


class ControllerFeed:
    """Follows all controllers.

    now_ns: the time of any clock. find_host: returns the host that may publish a controller, where that is known: of
    the fleet file.
    """

    def __init__(
        self,
        bus: Bus,
        keys: FleetKeys,
        now_ns: Callable[[], int],
        receiver: FeedReceiver,
        find_host: Callable[[str], str | None] = lambda _: None,
    ) -> None:
        self._bus, self._keys, self._now_ns = bus, keys, now_ns
        self._receiver = receiver
        self._find_host = find_host
        self._tasks = TaskOwner()
        self._hosts: dict[str, _KnownHost] = {}
        self._carriers: dict[str, str] = {}
        """By controller: the host that carries it."""
        self._tokens: dict[str, set[str]] = {}
        """By controller of a host without frames: the tokens of its adapter."""
        self._singles: dict[str, BusDeclaration] = {}
        self._changing = asyncio.Lock()
        self._declared: list[BusDeclaration] = []

    async def start(self) -> None:
        """Subscribe, and read the states of now."""
        bus, keys = self._bus, self._keys
        self._declared = [
            await bus.subscribe(keys.host_states(), self._receive_states),
            await bus.subscribe(keys.host_events(), self._receive_events),
            await bus.watch(keys.live("controller"), self._receive_token),
        ]
        for key, payload in (await bus.request_all(keys.host_states(), b"", ASK_S)).items():
            self._take_answer(key.split("/")[-2], payload)

    async def close(self) -> None:
        """End it."""
        self._tasks.cancel_all()
        for declaration in [*self._declared, *self._singles.values()]:
            await declaration.undeclare()

    # Frames

    def _receive_states(self, sample: BusSample) -> None:
        frame = self._read_frame(sample.key.split("/")[-2], sample.payload)
        if frame is None:
            return
        header, host = frame.header, self._hosts.get(frame.header.host)
        if host is None or host.instance != header.instance:
            host = self._hosts[header.host] = _KnownHost(header.instance, header.number - 1, {}, 0)
            is_complete = header.key
        elif header.number <= host.number:
            return  # it was repeated, or came behind a later one: its states are old
        else:
            is_complete = header.key or header.number == host.number + 1
        host.number = header.number
        if not self._pass_on(host, frame) or not is_complete:
            self._ask_for_all(header.host, host)

    def _receive_events(self, sample: BusSample) -> None:
        frame = self._read_frame(sample.key.split("/")[-2], sample.payload)
        if frame is not None:
            self._pass_lines(frame, {})

    def _read_frame(self, host: str, payload: bytes) -> HostFrame | None:
        try:
            frame = decode_frame(payload)
        except BadFrame as error:
            self._receiver.take_bad_frame(str(error))
            return None
        if frame.header.host != host:
            self._receiver.take_bad_frame(f"a frame of host {frame.header.host} on the key of host {host}")
            return None
        return frame

    def _pass_on(self, host: _KnownHost, frame: HostFrame) -> bool:
        """Pass on a frame of states; whether every state that it confirms has arrived."""
        name, now_ns = frame.header.host, self._now_ns()
        host.framed_ns = now_ns
        for controller in frame.confirmations:
            self._carriers[controller] = self._find_carrier(controller, name, now_ns)
        arrived_controllers = {line.controller for line in frame.lines if line.leaf == "state"}
        confirmations = {
            controller: confirmation
            for controller, confirmation in frame.confirmations.items()
            if self._carriers[controller] == name
        }
        for controller in arrived_controllers & confirmations.keys():
            host.seqs[controller] = confirmations[controller].seq
        self._pass_lines(frame, confirmations)
        return all(host.seqs.get(controller) == entry.seq for controller, entry in confirmations.items())

    def _pass_lines(self, frame: HostFrame, confirmations: Mapping[str, Confirmation]) -> None:
        name, head = frame.header.host, f"{self._keys.prefix}/ctl/"
        samples: list[BusSample] = []
        strangers: set[str] = set()
        for controller, leaf, payload in frame.lines:
            if self._carriers.setdefault(controller, self._find_host(controller) or name) == name:
                samples.append(BusSample(f"{head}{controller}/{leaf}", payload))
            else:
                strangers.add(controller)
        self._receiver.take_arrival(Arrival(name, samples, confirmations))
        if strangers:
            names = ", ".join(sorted(strangers))
            self._receiver.take_bad_frame(f"host {name} publishes {names}, which another host carries")

    def _find_carrier(self, controller: str, name: str, now_ns: int) -> str:
        """The host that may publish a controller, of which host `name` says that it carries it."""
        if (host := self._find_host(controller)) is not None:
            return host
        carrier = self._carriers.get(controller, name)
        known_host = self._hosts.get(carrier)
        is_there = known_host is not None and now_ns - known_host.framed_ns < CARRIED_NS
        return carrier if is_there else name

    # Gaps

    def _ask_for_all(self, name: str, host: _KnownHost) -> None:
        """A frame is missing, or the first one was not complete: ask the host for all states, now and then."""
        now_ns = self._now_ns()
        if host.is_asking or (host.asked_ns is not None and now_ns < host.asked_ns + ASK_AGAIN_NS):
            return
        host.is_asking, host.asked_ns = True, now_ns
        self._tasks.spawn(self._request_all(name, host))

    async def _request_all(self, name: str, host: _KnownHost) -> None:
        try:
            self._take_answer(name, await self._bus.request(self._keys.host_states(name), b"", ASK_S))
        except BusError:
            pass  # the next frame asks again
        finally:
            host.is_asking = False

    def _take_answer(self, name: str, payload: bytes) -> None:
        """Take all states of a host as of its last frame. Later frames may have come meanwhile: then what they brought
        is newer."""
        frame = self._read_frame(name, payload)
        if frame is None:
            return
        header, host = frame.header, self._hosts.get(name)
        if host is None or host.instance != header.instance:
            host = self._hosts[name] = _KnownHost(header.instance, header.number, {}, 0)
        new = {
            controller
            for controller, entry in frame.confirmations.items()
            if controller not in host.seqs or host.seqs[controller] < entry.seq
        }
        host.number = max(host.number, header.number)
        lines = [line for line in frame.lines if line.controller in new]
        confirmations = {controller: entry for controller, entry in frame.confirmations.items() if controller in new}
        self._pass_on(host, HostFrame(header, lines, confirmations))

    # Hosts without frames

    def _receive_token(self, key: str, present: bool) -> None:  # noqa: FBT001 - a callback
        controller, instance = key.split("/")[-2:]
        tokens = self._tokens.setdefault(controller, set())
        if present:
            tokens.add(instance)
        else:
            tokens.discard(instance)
        self._tasks.spawn(self._follow_token(controller))

    async def _follow_token(self, controller: str) -> None:
        """Subscribe to the keys of a controller while its adapter announces itself, and read its state."""
        async with self._changing:
            is_wanted, subscription = bool(self._tokens[controller]), self._singles.get(controller)
            if is_wanted == (subscription is not None):
                return
            if subscription is not None:
                del self._singles[controller]
                await subscription.undeclare()
                return
            key = self._keys.controller(controller)
            self._singles[controller] = await self._bus.subscribe(key, self._receive_single)
        key = self._keys.state(controller)
        try:
            payload = await self._bus.request(key, b"", ASK_S)
        except BusError:
            return  # it will publish its state
        self._receive_single(BusSample(key, payload))

    def _receive_single(self, sample: BusSample) -> None:
        self._receiver.take_arrival(Arrival("", [sample], {}))
