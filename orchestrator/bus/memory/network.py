"""The network between computers under the in-memory bus: delay, jitter, repeated packets, and cuts in one direction.

Processes on one computer reach each other as without it. A lost packet is not a lost message: TCP repeats it, so a
share of lost packets is a share of messages that arrive late. Its random values come from a generator of its own: a
bus without such a network behaves as if this module did not exist.
"""

from dataclasses import dataclass
from random import Random

from orchestrator.bus.memory.medium import BusProcess
from orchestrator.clock.base import NS_PER_MS

REPEAT_NS = 200 * NS_PER_MS
"""When TCP repeats a packet at the earliest that is not acknowledged (Linux, TCP_RTO_MIN)."""


@dataclass(frozen=True, slots=True)
class NetworkPath:
    """One direction between two computers. delay_ns: least delay; jitter_ns: up to this much more, evenly distributed.
    loss: share of messages one packet of which must be repeated."""

    delay_ns: int = 0
    jitter_ns: int = 0
    loss: float = 0.0

    def draw_ns(self, rng: Random) -> int:
        """One draw of the delay."""
        delay_ns = self.delay_ns + (rng.randrange(self.jitter_ns + 1) if self.jitter_ns else 0)
        return delay_ns + (REPEAT_NS if self.loss and rng.random() < self.loss else 0)


class Network:
    """The paths between computers, which all lead through the router's. Computer "" is that of the router."""

    def __init__(self, seed: int) -> None:
        self._rng = Random(seed)
        self._paths: dict[tuple[str, str], NetworkPath] = {}
        self._deaf: set[str] = set()
        self._mute: set[str] = set()
        self._lost: set[str] = set()
        self.router_hangs = False
        """Nothing passes between any two processes."""
        self.router_lost = False
        """The lease of all sessions has ended, or they are not back yet."""

    def set_path(self, computer: str, *, to: NetworkPath, back: NetworkPath | None = None) -> None:
        """Set the path from the router's computer to another, and the one back (None: the same)."""
        self._paths["", computer] = to
        self._paths[computer, ""] = to if back is None else back

    def delay_ns(self, sender: BusProcess, receiver: BusProcess) -> int:
        """The delay of a message that is sent now."""
        if not self._paths or sender.computer == receiver.computer:
            return 0
        legs = (self._paths.get((sender.computer, "")), self._paths.get(("", receiver.computer)))
        return sum(leg.draw_ns(self._rng) for leg in legs if leg is not None)

    def cut_computer(self, computer: str, *, receives: bool = False, sends: bool = False) -> None:
        """From now on nothing from other computers reaches this one, unless it `receives`, and nothing leaves it,
        unless it `sends`."""
        if not receives:
            self._deaf.add(computer)
        if not sends:
            self._mute.add(computer)

    def mend_computer(self, computer: str) -> None:
        """End what `cut_computer` began."""
        self._deaf.discard(computer)
        self._mute.discard(computer)

    def is_cut(self, sender: BusProcess, receiver: BusProcess) -> bool:
        """Whether nothing passes from one process to the other now."""
        is_apart = sender.computer != receiver.computer
        is_cut = is_apart and (sender.computer in self._mute or receiver.computer in self._deaf)
        return is_cut or (self.router_hangs and sender is not receiver)

    def is_cut_off(self, computer: str) -> bool:
        """Whether nothing reaches a computer, or nothing leaves it."""
        return computer in self._deaf or computer in self._mute

    def set_lost(self, computer: str, *, lost: bool) -> None:
        """The lease of the connections of a computer has ended, or they are back."""
        (self._lost.add if lost else self._lost.discard)(computer)

    def is_lost(self, one: BusProcess, other: BusProcess) -> bool:
        """Whether two processes count each other as gone."""
        is_away = one.computer != other.computer and (one.computer in self._lost or other.computer in self._lost)
        return is_away or (self.router_lost and one is not other)
