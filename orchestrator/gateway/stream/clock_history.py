"""How the clock of each controller was known over the last half hour, for the drawing of the service view."""

from collections import deque
from typing import Any

from orchestrator.clock.base import NS_PER_S
from orchestrator.model.state import ClockMapping

KEPT = 600
EVERY_NS = 3 * NS_PER_S
MAX_CONTROLLERS = 2000


class ClockHistory:
    """Takes mappings, at most one in three seconds of each controller."""

    def __init__(self) -> None:
        self._kept: dict[str, deque[tuple[int, ClockMapping]]] = {}

    def take_mapping(self, mapping: ClockMapping, now_ns: int) -> None:
        """Store a mapping that was published at `now_ns` of this process."""
        if mapping.controller not in self._kept and len(self._kept) >= MAX_CONTROLLERS:
            return
        mappings = self._kept.setdefault(mapping.controller, deque(maxlen=KEPT))
        if not mappings or now_ns - mappings[-1][0] >= EVERY_NS:
            mappings.append((now_ns, mapping))

    def show(self) -> dict[str, Any]:
        """By controller: times (s, of the gateway's clock), bounds (µs), rates (ppm), and the offset (µs) by which the
        controller's clock has gone astray since the first of them, at the rate that it had then."""
        return {name: _show_mappings(list(mappings)) for name, mappings in self._kept.items()}


def _show_mappings(kept: list[tuple[int, ClockMapping]]) -> dict[str, list[float]]:
    first = kept[0][1]
    return {
        "t": [round(at_ns / NS_PER_S, 3) for at_ns, _ in kept],
        "bound_us": [round(mapping.bound_ns / 1e3, 3) for _, mapping in kept],
        "rate_ppm": [round(mapping.rate_ppm, 4) for _, mapping in kept],
        "offset_us": [
            round(
                (mapping.host_at_ns - first.host_at_ns - (mapping.ticks_at - first.ticks_at) * first.tick_ns) / 1e3, 3
            )
            for _, mapping in kept
        ],
    }
