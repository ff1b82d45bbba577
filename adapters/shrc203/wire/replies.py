"""Reply formats: the patterns that distinguish a reply from garbage, and their parsing. They bound every number: a
coordinate has a sign and nine digits (L422, L3057), so that a longer one, `inf` or an exponent is garbage.

Lists (`1000,NS,-5`) contain one entry for each controllable axis, ascending, when the query names no axis or W.
"""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from orchestrator.model.messages import RefusalDetails

REFUSALS = ("NG", "NG_I")
_PULSES = r"[+-]?\d{1,9}(?:\.0{0,9})?"
MODES = ("HOST", "HOST,PROGRAM", "HOST,MS", "MANUAL", "REMOTE", "TEACHING", "EDIT", "LOAD", "TEST")


@dataclass(frozen=True, slots=True)
class ShrcReplyFormat:
    """The format of a reply: its description, and the pattern, which is matched without blanks."""

    words: str
    pattern: re.Pattern[str]

    def matches_line(self, line: str) -> bool:
        return self.pattern.fullmatch(line) is not None


def _make_format(words: str, pattern: str) -> ShrcReplyFormat:
    return ShrcReplyFormat(words, re.compile(pattern, re.ASCII))


DONE = _make_format("OK, OK_D, NG or NG_I", r"OK(_D)?|NG(_I)?")
ANYTHING = _make_format("any line", r".+")
MODE = _make_format("a mode", "|".join(MODES))
FORMAT = _make_format("SHOT_FC or HIT", r"SHOT_FC|HIT")
IDENTITY = _make_format("vendor,model,serial,firmware", r"[^,]+,[^,]+,[^,]+,[^,]+")
COMMAND = _make_format("the previous command", r"[^0-9].*")
CONTROLLABLE = _make_format("0 to 6", r"[0-6]")
BITS = _make_format("0 to 63", r"[0-5]?\d|6[0-3]")
SETTLING = _make_format("0 to 2550", r"\d{1,4}")
NOT_SET = _make_format("NS or a setting", r"NS|.+,.+")
READY = _make_format("R or B", r"[RB]")
STOPS = _make_format("X or K, how the axes have stopped, R or B", r"[XK],[123CDEWRK],[RB]")


def _status_format(axes: int) -> str:
    """Return the format with as many coordinates as status words as states: a reply without one of its commas is
    another reply."""
    return ",".join(
        column_format for column_format in (rf"[PNUMD]?{_PULSES}", "[0-9A-F]{1,8}", "[RBD]") for _ in range(axes)
    )


STATUS = _make_format("coordinates, status words and states", "|".join(_status_format(axes) for axes in (1, 2, 3)))


def list_format(pattern: str, count: int, words: str) -> ShrcReplyFormat:
    """Return the format of a list of `count` entries that match `pattern`."""
    return _make_format(f"{count} of {words}", ",".join([f"(?:{pattern})"] * count))


def flag_list(count: int) -> ShrcReplyFormat:
    return list_format("[01]", count, "0 or 1")


def pulse_list(count: int) -> ShrcReplyFormat:
    return list_format(f"NS|{_PULSES}", count, "pulses or NS")


def speed_list(count: int) -> ShrcReplyFormat:
    return list_format(r"S\d{1,9}F\d{1,9}R\d{1,9}", count, "SsFfRr")


def division_list(count: int) -> ShrcReplyFormat:
    return list_format(r"\d{1,4}", count, "divisions")


def size_list(count: int) -> ShrcReplyFormat:
    return list_format(r"\d{1,9}(?:\.\d{1,9})?", count, "nm")


def _parse_pulses(text: str) -> int:
    """Return a number of pulses, which may be printed with zeros after a point."""
    return int(text.partition(".")[0])


def parse_entries(reply: str) -> list[int | None]:
    """Return the whole numbers of a list; None where nothing is set."""
    return [None if entry == "NS" else _parse_pulses(entry) for entry in reply.split(",")]


def parse_triple(text: str) -> tuple[int, int, int]:
    """Return S, F (pls/s) and R (ms) of `SsFfRr`."""
    s, f, r = map(int, re.findall(r"\d+", text))
    return s, f, r


@dataclass(frozen=True, slots=True)
class AxisStatus:
    """One axis in a `Q:S` reply: coordinate (pls), status word, and R, B or D (ready, busy, not controllable)."""

    counts: int
    word: int
    state: str

    @property
    def is_busy(self) -> bool:
        return self.state == "B"


def parse_status(reply: str, controllable: tuple[int, ...]) -> dict[int, AxisStatus]:
    """Parse a `Q:SPC` reply, by motor. An axis that is not controllable reads 0,0,D or is omitted (L569, L581)."""
    fields = reply.split(",")
    count = len(fields) // 3
    motors = (1, 2, 3) if count == 3 else controllable
    return {
        motor: AxisStatus(_parse_pulses(fields[i].lstrip("PNUMD")), int(fields[count + i], 16), fields[2 * count + i])
        for i, motor in enumerate(motors)
        if motor in controllable
    }


# Axes that a limit sensor has stopped, by the second letter of Q: and SRQ: (L432-L446). These are not the axis letters.
_LIMIT_STOPPED = {"1": {1}, "2": {2}, "3": {3}, "C": {1, 2}, "D": {1, 3}, "E": {2, 3}, "W": {1, 2, 3}}


def parse_limit_stops(reply: str) -> set[int]:
    """Return the motors whose last motion was ended by a limit sensor, from the reply to `SRQ:`; none is named after an
    error."""
    return _LIMIT_STOPPED.get(reply.split(",")[1], set())


def refusal_of(command: str) -> RefusalDetails:
    """Return the refusal for an `NG`."""
    return RefusalDetails(
        code="refused",
        text=f"the controller answered NG to {command!r}",
        remedy="see its display: an axis may be busy, its motor off, or another mode selected",
    )


_LETTERS: dict[tuple[int, ...], str] = {
    (1,): "1",
    (2,): "2",
    (3,): "3",
    (1, 2): "A",
    (1, 3): "B",
    (2, 3): "C",
    (1, 2, 3): "D",
}

# The reply of `?:AXIS`: which axes are controllable (L2206-L2222).
AXES_BY_CODE = {"0": (1,), "1": (2,), "2": (3,), "3": (1, 2), "4": (1, 3), "5": (2, 3), "6": (1, 2, 3)}


def axis_argument(motors: Iterable[int]) -> str:
    """Return the axis argument that denotes exactly `motors` (one to three of 1, 2, 3)."""
    return _LETTERS[tuple(sorted(set(motors)))]
