"""Node guarding and heartbeats: of this node, and of the nodes that it watches (CiA 301)."""

from typing import Protocol

from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.can import CanFrame
from orchestrator.link.can_bus import CanNode
from sim.cia402.dictionary import DriveDictionary
from sim.cia402.timers import NodeTimers


class SupervisedNode(Protocol):
    """The node as its supervision sees it."""

    @property
    def node(self) -> int: ...

    @property
    def state(self) -> int: ...

    @property
    def can(self) -> CanNode: ...

    @property
    def dictionary(self) -> DriveDictionary: ...

    def handle_node_loss(self) -> None:
        """Handle the loss of the node that guards this one, or of a node that this one watches."""
        ...


class NodeSupervision:
    """Heartbeats and guarding of one node."""

    def __init__(self, host: SupervisedNode, timers: NodeTimers) -> None:
        self._host = host
        self._timers = timers
        self._toggle = 0

    def reset_toggle(self) -> None:
        """Start again with a toggle bit of 0, after a boot-up."""
        self._toggle = 0

    def restart_heartbeat(self, every_ms: int) -> None:
        """Send heartbeats at this interval; 0: none."""
        self._timers.cancel_timer("heartbeat")
        if every_ms:

            def send_heartbeat() -> None:
                self._host.can.queue_frames(CanFrame(0x700 + self._host.node, bytes([self._host.state])))
                self._timers.call_later("heartbeat", every_ms * NS_PER_MS, send_heartbeat)

            self._timers.call_later("heartbeat", every_ms * NS_PER_MS, send_heartbeat)

    def answer_guarding(self) -> None:
        """Node guarding: answer with the state and a bit that alternates."""
        self._host.can.queue_frames(CanFrame(0x700 + self._host.node, bytes([self._host.state | self._toggle << 7])))
        self._toggle ^= 1
        life_ms = self._host.dictionary.get_value(0x100C) * self._host.dictionary.get_value(0x100D)
        if life_ms:
            self._timers.call_later("life", life_ms * NS_PER_MS, self._host.handle_node_loss)

    def handle_heartbeat(self, node: int) -> None:
        """Handle a heartbeat of another node: expect the next one in time."""
        for sub in (1, 2):
            word = self._host.dictionary.get_value(0x1016, sub)
            if word >> 16 & 0x7F == node and word & 0xFFFF:
                self._timers.call_later(f"consumer{sub}", (word & 0xFFFF) * NS_PER_MS, self._host.handle_node_loss)
