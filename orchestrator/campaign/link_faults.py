"""Faults of the link to a controller, and of what arrives over it."""

from collections.abc import Callable
from contextvars import Context
from dataclasses import replace
from random import Random

from orchestrator.campaign.injection.arbitrary_replies import ArbitraryReplies
from orchestrator.campaign.injection.repairs import Repair
from orchestrator.campaign.stages.fleet_parts import find_traits
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.virtual import VirtualClock
from orchestrator.link.direct import DirectWire
from orchestrator.link.memory import MemoryWire
from orchestrator.runtime.virtual.fleet import VirtualFleet

MAX_EXTRA_LATENCY_NS = 150 * NS_PER_MS
REFUSALS_NS = 300 * NS_PER_MS
# Long before the repair: what was asked meanwhile has failed by then, after up to a second.
ARBITRARY_REPLIES_NS = 800 * NS_PER_MS
# A flapping link: for how long it is closed again and again, how long it is open each time, and how long nothing can be
# opened then.
FLAPPING_NS = 1100 * NS_PER_MS
LATE_NS = NS_PER_S  # of a load that is answered late
OPEN_NS = (250 * NS_PER_MS, 500 * NS_PER_MS)
CLOSED_NS = (0, 150 * NS_PER_MS)


class LinkFaults:
    """Injects faults of the links of one fleet."""

    def __init__(self, fleet: VirtualFleet, clock: VirtualClock, draw: Random) -> None:
        self._fleet = fleet
        self._clock = clock
        self._draw = draw
        self._whole_fleet = fleet.fleet

    def inject_fault(self, fault: str, member: str) -> Repair:
        """Inject a fault of the member's link; return its repair."""
        fleet, wire = self._fleet, self._fleet.wires[member]
        usual = wire.model

        def restore_wire() -> None:
            wire.cut, wire.to_near, wire.to_far, wire.model = False, None, None, usual
            wire.lose_close = False

        can = self._whole_fleet.controllers[member].link.kind == "can"
        match fault:
            case "link-cut":
                wire.cut = True
            case "link-closed" | "cable-pulled":
                wire.lose_close = fault == "cable-pulled"  # the controller keeps half-open connections
                _close_links(wire)
            case "link-slow":
                wire.model = replace(usual, latency_ns=usual.latency_ns + self._draw.randrange(MAX_EXTRA_LATENCY_NS))
            case "garbage":
                # Corrupted frames on a CAN bus are not delivered at all.
                wire.to_near = self._drop_bytes if can else self._corrupt_bytes
            case "refusals":
                refuse_reply = find_traits(self._whole_fleet.controllers[member].adapter).refuse_reply
                if refuse_reply is None:
                    wire.to_far = lambda _: b""
                else:
                    wire.to_near = refuse_reply
                self._schedule_call(REFUSALS_NS, restore_wire)
            case "flapping-link":
                self._flap_link(wire)
            case "load-late":
                self._answer_load_late(wire, member)
            case "arbitrary-replies":
                replies = ArbitraryReplies(self._draw)
                wire.to_near = replies.change_frames if can else replies.change_bytes
                self._schedule_call(ARBITRARY_REPLIES_NS, restore_wire)
            case _:  # firmware-hung
                fleet.freeze(f"sim/{member}")
                return lambda: fleet.resume(f"sim/{member}")
        return restore_wire

    def _answer_load_late(self, wire: MemoryWire, member: str) -> None:
        """Answer the next load of a move late, once."""
        loads = find_traits(self._whole_fleet.controllers[member].adapter).loads
        assert isinstance(wire, DirectWire) and loads is not None  # the makes of this fault

        def find_late_ns(request: bytes) -> int:
            if not loads(request):
                return 0
            wire.find_late_ns = None
            return LATE_NS

        wire.find_late_ns = find_late_ns

    def _flap_link(self, wire: MemoryWire) -> None:
        """Close the link again and again for a while; after each time it cannot be opened at once."""
        until_ns = self._clock.now_ns() + FLAPPING_NS

        def close_wire() -> None:
            if self._clock.now_ns() < until_ns:
                wire.refuse = True
                _close_links(wire)
                self._schedule_call(self._draw.randint(*CLOSED_NS), open_wire)

        def open_wire() -> None:
            wire.refuse = False
            self._schedule_call(self._draw.randint(*OPEN_NS), close_wire)

        close_wire()

    def _corrupt_bytes(self, data: bytes) -> bytes:
        return bytes(self._draw.randrange(256) for _ in data)

    def _drop_bytes(self, data: bytes) -> bytes:
        return b"" if self._draw.random() < 0.7 else data

    def _schedule_call(self, after_ns: int, call: Callable[[], None]) -> None:
        """Schedule a call outside of every process."""
        self._clock.call_at_ns(self._clock.now_ns() + after_ns, call, context=Context())


def _close_links(wire: MemoryWire) -> None:
    for link in list(wire.links):
        link.hang_up()
