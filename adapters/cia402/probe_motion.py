"""A probe of a drive: it moves to the end of its way, a touch probe captures where the input changed, and this computer
halts it as soon as it sees that.

It sees that by 60B9h, which is read again and again, and sooner by the drive's own message of a changed input.
"""

import asyncio
from contextlib import suppress

from adapters.cia402.canopen.objects import point_bit
from adapters.cia402.canopen.touch_probe import TouchProbe, find_edge
from adapters.cia402.connection import Cia402Connection
from adapters.contract import HostInterval, JogMove, ProbedContact, ProbeMove
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal
from orchestrator.model.state import ProbeAbility

LOOK_NS = 5 * NS_PER_MS
ARRIVING_NS = 20 * NS_PER_MS
"""A drive shows its target as reached when the axis is in the window around it, before the demand is there."""
READ_S = 0.03  # a read of 60B9h that takes longer ends the probe
HALT_S = 0.015  # of the halt to the drive, with its cycle
CAPTURE_S = 1e-4  # from the edge to the captured position, at most; it is captured in hardware
CAPTURE_COUNTS = 1.0
END_COUNTS = 2


def find_ability(axis: str, inputs: tuple[int, ...]) -> ProbeAbility:
    """How a drive stops its axis by its touch probes. inputs: the numbers of those that are touch probe 1 and 2."""
    return ProbeAbility(
        inputs={axis: list(inputs)},
        levels=["active", "passive"],
        reaction_s=LOOK_NS / NS_PER_MS / 1000 + 2 * READ_S + HALT_S,
        ramp_share=0.75,
        margin_counts=2 * CAPTURE_COUNTS + END_COUNTS,
        contact_s=CAPTURE_S,
        contact_counts=CAPTURE_COUNTS,
    )


class ProbeMotion:
    """Probes of one connection. inputs: as of `find_ability`."""

    def __init__(self, connection: Cia402Connection, axis: str, inputs: tuple[int, ...]) -> None:
        self._node = connection.node
        self._power = connection.power
        self._manual = connection.manual
        self._axis = axis
        self._inputs = inputs

    async def run(self, move: ProbeMove) -> ProbedContact | None:
        """As `ProbeDriver.probe_axis`. Raises `Refusal`, `ControllerFault`."""
        point = move.point.model_copy(update={"active": "high" if move.level else "low"})
        touch = TouchProbe(self._node, self._axis, find_edge(point, self._inputs))
        stops = self._node.stops
        await touch.require_passive(point)
        async with touch.switched_on():
            try:
                return await self._move(touch, move, stops)
            except BaseException:
                with suppress(LinkClosed):
                    self._power.write_stop(abort=False)
                raise

    async def _move(self, touch: TouchProbe, move: ProbeMove, stops: int) -> ProbedContact | None:
        node = self._node
        sign = 1 if move.end_counts >= node.demand else -1
        begun_ns = node.clock.now_ns()
        # A jog counts stops from its own begin on.
        self._require_no_stop(stops)
        await self._manual.start_jog(JogMove(sign * move.speed_counts_s, move.ramp_counts_s2, move.end_counts))
        bit, level = point_bit(move.point.number), move.level
        ended_ns: int | None = None
        while True:
            self._require_no_stop(stops)
            asked_ns = node.clock.now_ns()
            if ended_ns is None and not self._manual.is_jogging:
                ended_ns = asked_ns
            is_over = ended_ns is not None and (self._is_at_end(move) or asked_ns >= ended_ns + ARRIVING_NS)
            counts = await self._read(touch)
            if counts is not None:
                self._power.write_stop(abort=False)
                seen_ns = node.clock.now_ns()
                await self._power.wait_for_stops()
                early, late = counts - sign * move.speed_counts_s * CAPTURE_S, float(counts)
                ends = (early - sign * CAPTURE_COUNTS, late + sign * CAPTURE_COUNTS)
                return ProbedContact(min(ends), max(ends), HostInterval(begun_ns, seen_ns))
            if is_over:
                self._require_end(move)
                return None
            begun_ns = asked_ns
            await node.wait_until(
                lambda: node.stops != stops or bool(node.inputs & bit) == level, node.clock.now_ns() + LOOK_NS
            )

    async def _read(self, touch: TouchProbe) -> int | None:
        try:
            async with asyncio.timeout(2 * READ_S):
                return await touch.read()
        except TimeoutError:
            text = f"axis {self._axis}: the drive takes too long to show its touch probe"
            raise Refusal("probe-broken", text, "see what else uses the bus, then probe again") from None

    def _require_no_stop(self, stops: int) -> None:
        if self._node.stops != stops:
            raise Refusal("stopped", f"axis {self._axis} was stopped while it probed", "probe again")

    def _is_at_end(self, move: ProbeMove) -> bool:
        return self._node.is_enabled and abs(self._node.demand - move.end_counts) <= END_COUNTS

    def _require_end(self, move: ProbeMove) -> None:
        node = self._node
        if not self._is_at_end(move):
            text = f"axis {self._axis} came to rest before its end, at {node.actual} counts"
            raise Refusal("probe-broken", text, "see the state of the axis: a limit switch, a fault?")
