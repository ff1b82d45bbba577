"""The place in fleet time of each line of several files.

Each line gets one instant in which all are sorted: its fleet time, moved by one constant so that it reads as UTC. A
step of the wall clock moves no line, because the constant is common to all lines of a fleet-time scale.

A line without fleet time (a process that has no coordinator yet) has UTC only. The distance between the two at the
nearest line of its file that has both makes fleet time of it; the line stays between its neighbours in the file, so
that a step of the wall clock between them does no harm. Lines without any time stay behind the line before them.

Fleet time begins anew with another scale, for example after the computer was restarted. In a file that is where it
falls by more than a second. Parts of different files are of one scale if at some time their distances to UTC agreed.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

from orchestrator.monitor.logs.line import LogLine

NEW_SCALE_NS = 1_000_000_000  # processes on one file may write their lines in another order, by far less than this
SAME_OFFSET_NS = 200_000_000  # a line takes its two times one after the other, on a computer that may be busy


@dataclass(frozen=True, slots=True)
class PlacedLine:
    """A line and its instant, ns since 1970, by which lines of all files are in order."""

    at_ns: int
    line: LogLine


@dataclass(slots=True)
class _ScalePart:
    """A part of a file in which fleet time runs on. begin: its first line with both times. offsets: UTC minus fleet
    time, each that differs. newest_ns: fleet time of its last line. common_ns: the offset that counts."""

    begin: int
    offsets: list[int] = field(default_factory=list[int])
    newest_ns: int = 0
    common_ns: int = 0

    def agrees(self, other: "_ScalePart") -> bool:
        """Whether the two are of one scale: on one computer, both had the same offset at some time."""
        return any(abs(offset - two) <= SAME_OFFSET_NS for offset in self.offsets for two in other.offsets)


def place_lines(files: Mapping[str, Sequence[LogLine]], fallback_ns: Mapping[str, int]) -> list[PlacedLine]:
    """Return the lines of all files in order of fleet time; those of one file with equal times in their order.

    files: the lines of each, in the order in which they were written. fallback_ns: for a file without any time, when
    it was written last, UTC.
    """
    parts = {name: _split_scales(lines) for name, lines in files.items()}
    _join_scales([part for scale_parts in parts.values() for part in scale_parts])
    placed_lines = [
        PlacedLine(at_ns, line)
        for name, lines in files.items()
        for at_ns, line in zip(_place_file(lines, parts[name], fallback_ns.get(name, 0)), lines, strict=True)
    ]
    placed_lines.sort(key=lambda line: line.at_ns)
    return placed_lines


def _split_scales(lines: Sequence[LogLine]) -> list[_ScalePart]:
    parts: list[_ScalePart] = []
    for number, line in enumerate(lines):
        if line.utc_ns is None or line.fleet_ns is None:
            continue
        if not parts or line.fleet_ns < parts[-1].newest_ns - NEW_SCALE_NS:
            parts.append(_ScalePart(number))
        part, offset = parts[-1], line.utc_ns - line.fleet_ns
        part.newest_ns = line.fleet_ns
        if not part.offsets or abs(part.offsets[-1] - offset) > SAME_OFFSET_NS // 4:
            part.offsets.append(offset)
    return parts


def _join_scales(parts: Iterable[_ScalePart]) -> None:
    """Give the parts of one scale one offset: the newest one."""
    scales: list[list[_ScalePart]] = []
    for part in parts:
        same_scales = [scale for scale in scales if any(part.agrees(other_part) for other_part in scale)]
        scales = [scale for scale in scales if scale not in same_scales]
        scales.append([part, *(other_part for scale in same_scales for other_part in scale)])
    for scale in scales:
        newest = max(scale, key=lambda part: part.newest_ns)
        for part in scale:
            part.common_ns = newest.offsets[-1]


class _Anchor(NamedTuple):
    """A line with both times. shift_ns: what makes an instant of the UTC of its neighbours."""

    at_ns: int
    shift_ns: int


def _place_file(lines: Sequence[LogLine], parts: Sequence[_ScalePart], fallback_ns: int) -> list[int]:
    """The instant of each line."""
    anchors = _find_anchors(lines, parts)
    anchors_before, anchors_after = _carry_on(anchors), _carry_on(reversed(anchors))
    found_at_ns = [
        anchor.at_ns if anchor is not None else _place_between(line.utc_ns, low, high)
        for line, anchor, low, high in zip(lines, anchors, anchors_before, reversed(anchors_after), strict=True)
    ]
    last_ns = next((at_ns for at_ns in found_at_ns if at_ns is not None), fallback_ns)
    instants: list[int] = []
    for at_ns in found_at_ns:
        last_ns = last_ns if at_ns is None else at_ns
        instants.append(last_ns)
    return instants


def _carry_on(anchors: Iterable[_Anchor | None]) -> list[_Anchor | None]:
    """For each line the last anchor up to it."""
    last: _Anchor | None = None
    carried_anchors: list[_Anchor | None] = []
    for anchor in anchors:
        last = anchor or last
        carried_anchors.append(last)
    return carried_anchors


def _find_anchors(lines: Sequence[LogLine], parts: Sequence[_ScalePart]) -> list[_Anchor | None]:
    begins = {part.begin: part.common_ns for part in parts}
    anchors: list[_Anchor | None] = []
    common_ns = 0
    for number, line in enumerate(lines):
        common_ns = begins.get(number, common_ns)
        if line.utc_ns is None or line.fleet_ns is None:
            anchors.append(None)
        else:
            anchors.append(_Anchor(line.fleet_ns + common_ns, common_ns - (line.utc_ns - line.fleet_ns)))
    return anchors


def _place_between(utc_ns: int | None, before: _Anchor | None, after: _Anchor | None) -> int | None:
    """The instant of a line without fleet time, not outside its neighbours; None without any time."""
    if utc_ns is None:
        return None
    wishes_ns = [utc_ns + anchor.shift_ns for anchor in (before, after) if anchor is not None] or [utc_ns]
    low_ns = before.at_ns if before is not None else min(wishes_ns)
    high_ns = after.at_ns if after is not None else max(wishes_ns)
    fitting = [at_ns for at_ns in wishes_ns if low_ns <= at_ns <= high_ns]
    return fitting[0] if fitting else max(low_ns, min(wishes_ns[0], high_ns))
