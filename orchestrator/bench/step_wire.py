"""What is said on the wires between the end of a step and the start of the next, and what of it evidence needs.

The frames are those that the drivers really send, from one gap in virtual time. The wire's own sum is the time of
those that evidence cannot do without (where the axes have ended, the target, its read-back, the begin), each once
for each controller: its bytes at the baud rate, and the mean time of the simulated firmware. How long a serial adapter
keeps received bytes is not in it.
"""

import re
from collections import deque
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

from orchestrator.bench.naive import Motions
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.memory import MemoryWire
from orchestrator.model.fleet import CanBusLink, Controller, SerialLink, group_by_link
from orchestrator.runtime.simulated import find_timing
from orchestrator.runtime.virtual.fleet import VirtualFleet

RECORDED_WRITES = 20_000  # on each wire: more than those of ten steps

_LINE = re.compile(rb"[^\r\n]*(?:\r\n|\r|\n)")

Need = Literal["end position", "target", "read-back", "begin"]


class NeededExchange(NamedTuple):
    """An exchange that evidence needs. line: the line that is sent; manual: lines of the make's manual."""

    line: re.Pattern[bytes]
    need: Need
    manual: str


def _needs(*rows: tuple[bytes, Need, str]) -> tuple[NeededExchange, ...]:
    return tuple(NeededExchange(re.compile(line), need, manual) for line, need, manual in rows)


NEEDED: Mapping[str, tuple[NeededExchange, ...]] = {
    "shrc203": _needs(
        (rb"Q:S", "end position", "L469-591"),
        (rb"(MP|AP):", "target", "L3092-3169"),
        (rb"\?:CMD", "read-back", "L2068-2088"),
        (rb"G:", "begin", "L4779-4822"),
    ),
    "smc30": _needs(
        (rb"\dV1", "end position", "L1926-1931"),
        (rb"\dR509=", "target", "L2912-2931"),
        (rb"\dVR509", "read-back", "L3006-3015"),
        (rb"\dE", "begin", "L1798-1805"),
    ),
    "ppsmc": _needs(
        (rb"\?s", "end position", "L4279-4320"),
        (rb"\?p", "end position", "L4222-4251"),
        (rb"tbc", "target", "L2953"),
        (rb"tbs", "target", "L3033"),
        (rb"\?tb", "read-back", "L4322-4346"),
        (rb"tbg", "begin", "L2987"),
    ),
}
"""By adapter. Settings (speeds, ramps) are not in it: between moves of one length they stay, if no other client
writes. An SMC-4000 is missing: what it does between two steps is its program's."""


class GapExchange(NamedTuple):
    """One line on a wire and its reply. at_ms: since the end of the step. out_ms, back_ms: their bytes at the baud
    rate. firmware_ms: the mean time of the firmware, by the simulator. is_between: its reply came after the end. need:
    empty: evidence does without it, or has the same from another exchange."""

    controller: str
    at_ms: float
    out: bytes
    back: bytes
    out_ms: float
    back_ms: float
    firmware_ms: float
    is_between: bool
    need: Need | Literal[""] = ""
    manual: str = ""

    @property
    def needed_ms(self) -> float:
        """Its part of the wire's own sum. The reply to a begin is not waited for."""
        if not self.need:
            return 0.0
        return self.out_ms + self.firmware_ms + (0.0 if self.need == "begin" else self.back_ms)


class WireRecord:
    """The bytes on one wire, in the order in which its ends send them."""

    def __init__(self, virtual: VirtualFleet, names: Sequence[str]) -> None:
        """names: the controllers of the wire."""
        self._clock = virtual.clock
        self._configs = {name: virtual.fleet.controllers[name] for name in names}
        self._entries: deque[tuple[int, bool, bytes]] = deque(maxlen=RECORDED_WRITES)
        wire: MemoryWire = virtual.wires[names[0]]
        self._char_ns = wire.model.char_ns
        wire.to_far, wire.to_near = self._record_sent, self._record_received

    def _record_sent(self, data: bytes) -> bytes:
        self._entries.append((self._clock.now_ns(), True, data))
        return data

    def _record_received(self, data: bytes) -> bytes:
        self._entries.append((self._clock.now_ns(), False, data))
        return data

    def list_exchanges(self, gap: "StepGap") -> list[GapExchange]:
        """What was sent from the start of a step until the start of the next one, in the order of the replies."""
        pairs = [pair for pair in self._pair_lines() if gap.begin_ns <= pair.at_ns < gap.start_ns]
        kinds: set[tuple[str, str]] = set()
        # Of each kind the last one before the begin is the one that evidence uses.
        return [self._describe(pair, gap, kinds) for pair in reversed(pairs)][::-1]

    def _pair_lines(self) -> "list[_LinePair]":
        """Each line that is sent with its reply. What a controller sends at one instant is one reply, and what comes
        behind a write belongs to its lines: a driver writes when it has the replies to what it has written before."""
        pairs: list[_LinePair] = []
        queue: deque[_LinePair] = deque()
        for at_ns, is_sent, data in self._entries:
            if is_sent:
                lines = [_LinePair(at_ns, line) for line in _LINE.findall(data)]
                pairs += lines
                queue = deque([pair for pair in lines if self._is_answered(pair.line)])
            elif queue and queue[0].replied_ns not in (None, at_ns):
                queue.popleft()
            if not is_sent and queue:
                queue[0].replied_ns, queue[0].back = at_ns, queue[0].back + data
        return pairs

    def _is_answered(self, line: bytes) -> bool:
        is_silent = next(iter(self._configs.values())).adapter == "ppsmc"
        return not is_silent or line.startswith(b"?")

    def _describe(self, pair: "_LinePair", gap: "StepGap", kinds: set[tuple[str, str]]) -> GapExchange:
        name, config = self._find_controller(pair.line)
        timing = find_timing(config)
        exchange = GapExchange(
            controller=name,
            at_ms=(pair.at_ns - gap.end_ns) / NS_PER_MS,
            out=pair.line,
            back=pair.back,
            out_ms=len(pair.line) * self._char_ns / NS_PER_MS,
            back_ms=len(pair.back) * self._char_ns / NS_PER_MS,
            firmware_ms=(timing.decode_ns + timing.spread_ns / 2) / NS_PER_MS,
            is_between=(pair.at_ns if pair.replied_ns is None else pair.replied_ns) > gap.end_ns,
        )
        row = next((row for row in NEEDED.get(config.adapter, ()) if row.line.match(pair.line)), None)
        if row is None or (name, row.manual) in kinds or not (row.need == "begin" or (name, "begin") in kinds):
            return exchange
        kinds |= {(name, row.manual), (name, row.need)}
        return exchange._replace(need=row.need, manual=row.manual)

    def _find_controller(self, line: bytes) -> tuple[str, Controller]:
        """The controller of a line: by its address where several share the wire."""
        for name, config in self._configs.items():
            address = config.link.address if isinstance(config.link, SerialLink) else None
            if address is not None and line.startswith(str(address).encode()):
                return name, config
        return next(iter(self._configs.items()))


class StepGap(NamedTuple):
    """The start and the end of a step, and the start of the next one, ns."""

    begin_ns: int
    end_ns: int
    start_ns: int


@dataclass(slots=True)
class _LinePair:
    """A line that was sent and, once there is one, its reply."""

    at_ns: int
    line: bytes
    back: bytes = b""
    replied_ns: int | None = None


def record_wires(virtual: VirtualFleet) -> list[WireRecord]:
    """Record the bytes on all wires of a fleet but those of CAN buses, which carry frames."""
    return [
        WireRecord(virtual, names)
        for names in group_by_link(virtual.fleet.controllers)
        if not isinstance(virtual.fleet.controllers[names[0]].link, CanBusLink)
    ]


def find_gap(motions: Motions) -> StepGap:
    """The gap among the last ten that is nearest to their median."""
    by_axis = [axis[-10:] for axis in motions.values()]
    gaps = [
        StepGap(
            min(axis[step - 1][0] for axis in by_axis),
            max(axis[step - 1][1] for axis in by_axis),
            min(axis[step][0] for axis in by_axis),
        )
        for step in range(1, min(map(len, by_axis)))
    ]
    return sorted(gaps, key=lambda gap: gap.start_ns - gap.end_ns)[len(gaps) // 2]
