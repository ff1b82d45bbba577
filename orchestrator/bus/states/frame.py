"""The frames of an adapter host: what its controllers publish, of many in one message.

A frame is lines of text. The first one is a `FrameHeader`. Each further line is a payload as it would stand on a key of
its own, `ctl/{id}/{leaf}`; `lines` of the header names their keys in the same order. So one payload that cannot be read
costs no other, and a reader decodes only what it needs.

Of a controller whose state has changed in nothing but its instants, the header alone says so (`states`).
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple

from pydantic import Field, ValidationError

from orchestrator.clock.utc import format_utc_ns, parse_utc_ns
from orchestrator.model.base import Id, Int53, Model
from orchestrator.model.errors import TuttiError
from orchestrator.model.problems import first_error_text
from orchestrator.model.state import ControllerState, TimeInterval

FRAME_NS = 400_000_000
"""Longest time between two frames of states: silence of 0.7 s stays the limit."""
SEEN_NS = 450_000_000
"""An adapter looks at its controller, or says that it cannot, every 0.4 s: as long as no look is older than this, its
host vouches for it with each frame. Otherwise the age of the last look counts."""
KEY_FRAME_NS = 10_000_000_000
"""Longest time between two frames with every state."""

_DAY_NS = 86_400_000_000_000  # no instant in a frame is farther from it

_LINE = re.compile(r"([a-z0-9_-]{1,64})/(state|event|clock|link)")


class BadFrame(TuttiError):
    """A frame that cannot be read; the message says why."""


class FrameHeader(Model):
    """The first line of a frame.

    number: counts the frames of states of an `instance` of the host, without gaps; 0 in a frame of events. key: every
    state is among the lines. states: by controller that the host carries, `[seq, age]` or `[seq, age, earliest, latest,
    read]`: `seq` of the state that was put into a frame last, and how long before the instant of the frame, ns, it was
    seen to hold still, and `read_within` and `read_fleet_ns` are. fleet_ns, utc: the instant of the frame.
    """

    schema_: Literal["tutti.host-frame/1"] = Field(default="tutti.host-frame/1", alias="schema")
    host: Id
    instance: str
    number: Int53
    key: bool = False
    utc: str
    fleet_ns: Int53 | None = None
    lines: list[str]
    states: dict[Id, list[Int53]]


class FrameLine(NamedTuple):
    """A payload of a controller. leaf: `state`, `event`, `clock` or `link`."""

    controller: str
    leaf: str
    payload: bytes


@dataclass(frozen=True, slots=True)
class Confirmation:
    """That a controller's state held until `age_ns` before a frame. seq: of that state. utc_ns, fleet_ns: the instant
    of the frame. reading_ns: how long before the frame `read_within` began and ended, and `read_fleet_ns` was; empty
    without a reading."""

    seq: int
    age_ns: int
    utc_ns: int
    fleet_ns: int | None
    reading_ns: Sequence[int]

    def apply(self, state: ControllerState) -> ControllerState:
        """The state with the instants of its last reading; one that is newer, or another one, as it is."""
        fleet_ns = None if self.fleet_ns is None else self.fleet_ns - self.age_ns
        if state.seq != self.seq or fleet_ns is None or fleet_ns <= (state.fleet_ns or 0):
            return state
        utc = format_utc_ns(self.utc_ns - self.age_ns)
        update: dict[str, Any] = {"utc": utc, "fleet_ns": fleet_ns, "read_within": None, "read_fleet_ns": None}
        if self.reading_ns:
            earliest_ns, latest_ns, read_ns = (fleet_ns + self.age_ns - ago_ns for ago_ns in self.reading_ns)
            update["read_within"] = TimeInterval(earliest_ns=earliest_ns, latest_ns=latest_ns)
            update["read_fleet_ns"] = read_ns
        return state.model_copy(update=update)


@dataclass(frozen=True, slots=True)
class HostFrame:
    """A frame that was read. confirmations: by controller that the host carries."""

    header: FrameHeader
    lines: Sequence[FrameLine]
    confirmations: Mapping[str, Confirmation]


def encode_frame(header: FrameHeader, payloads: Sequence[bytes]) -> bytes:
    """The message of a frame. payloads: of `header.lines`, JSON without line feeds."""
    return b"\n".join((header.to_json(), *payloads))


def decode_frame(payload: bytes) -> HostFrame:
    """Read a frame; its payloads stay as they are. Raises `BadFrame`."""
    first, *payloads = payload.split(b"\n")
    try:
        header = FrameHeader.read_message(first)
    except ValidationError as error:
        raise BadFrame(f"the first line of a frame cannot be read: {first_error_text(error)}") from None
    utc_ns = _read_utc(header.utc)
    if len(payloads) != len(header.lines):
        raise BadFrame(f"a frame of host {header.host} has {len(payloads)} lines, and names {len(header.lines)}")
    lines = [FrameLine(*_split_line(name), text) for name, text in zip(header.lines, payloads, strict=True)]
    confirmations: dict[str, Confirmation] = {}
    for name, entry in header.states.items():
        if len(entry) not in (2, 5):
            raise BadFrame(f"a frame of host {header.host} has a state of {len(entry)} numbers; 2 or 5 are needed")
        if entry[1] < 0 or any(abs(ago_ns) > _DAY_NS for ago_ns in entry[1:]):
            raise BadFrame(f"a frame of host {header.host} has a state of another day")
        confirmations[name] = Confirmation(entry[0], entry[1], utc_ns, header.fleet_ns, entry[2:])
    return HostFrame(header, lines, confirmations)


def _read_utc(text: str) -> int:
    try:
        utc_ns = parse_utc_ns(text)
    except ValueError:
        utc_ns = 0
    if utc_ns < _DAY_NS:
        raise BadFrame("the first line of a frame has no instant `utc`")
    return utc_ns


def _split_line(name: str) -> tuple[str, str]:
    match = _LINE.fullmatch(name)
    if match is None:
        raise BadFrame(f"a frame names a line {name[:80]!r}; a controller and state, event, clock or link are needed")
    return match[1], match[2]


def encode_entry(state: ControllerState, seq: int, age_ns: int) -> list[int]:
    """The numbers of a state in a header. seq: of the state that was put into a frame last; state: as it was seen
    `age_ns` before the frame."""
    if state.fleet_ns is None or state.read_within is None:
        return [seq, age_ns]
    base_ns = state.fleet_ns + age_ns
    read_ns = state.read_fleet_ns if state.read_fleet_ns is not None else state.read_within.latest_ns
    interval = state.read_within
    return [seq, age_ns, base_ns - interval.earliest_ns, base_ns - interval.latest_ns, base_ns - read_ns]
