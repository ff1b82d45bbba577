"""Faults of the numbered frames in which a host publishes the states of its controllers."""

from collections.abc import Sequence
from contextvars import Context
from random import Random

from orchestrator.bus.base import BusSample
from orchestrator.bus.memory.disturbances import Deal
from orchestrator.bus.states.frame import decode_frame
from orchestrator.campaign.injection.repairs import Repair
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.virtual import VirtualClock
from orchestrator.runtime.virtual.fleet import VirtualFleet

REPEATED_NS = (0, 300 * NS_PER_MS)  # from a frame to its copy: others come in between
OVERTAKEN_NS = (0, 300 * NS_PER_MS)  # by how much a frame is late: by several of the next ones
UNANSWERED = ("key-frames-lost", "states-lost")
"""Faults in which no request for all states is answered either, for as long as from one key frame to the next."""
UNANSWERED_NS = 10 * NS_PER_S


class FrameFaults:
    """Injects faults of the frames of states of one fleet."""

    def __init__(self, fleet: VirtualFleet, clock: VirtualClock, draw: Random) -> None:
        self._fleet = fleet
        self._clock = clock
        self._draw = draw
        self._losing = False
        """Whether the next frame is to be lost."""

    def inject_fault(self, fault: str, host: str) -> Repair:
        """Inject a fault of the frames of a host; return its repair."""
        key, disturbances, draw = self._fleet.keys.host_states(host), self._fleet.net.disturbances, self._draw
        deals: dict[str, Deal] = {
            "frame-lost": self._lose_frame,
            "frames-repeated": lambda _: (0, draw.randint(*REPEATED_NS)),
            "frames-reordered": lambda _: (draw.randint(*OVERTAKEN_NS),),
            "key-frames-lost": lambda sample: () if decode_frame(sample.payload).header.key else (0,),
            "states-lost": lambda sample: () if decode_frame(sample.payload).lines else (0,),
        }
        self._losing = True
        disturbances.disturb_samples(key, deals[fault])
        if fault not in UNANSWERED:
            return lambda: disturbances.end(key)
        disturbances.unanswered.add(key)

        def end() -> None:
            disturbances.end(key)

        self._clock.call_at_ns(self._clock.now_ns() + UNANSWERED_NS, end, context=Context())
        return lambda: None

    def _lose_frame(self, _: BusSample) -> Sequence[int]:
        """Lose the next one: with two, a host would be silent for too long."""
        is_lost, self._losing = self._losing, False
        return () if is_lost else (0,)
