"""What replies look like: the forms that tell a reply from garbage, and their parsing.

Lists (`1000,NS,-5`) come with one entry for each controllable axis, ascending, when no axis or W is asked for.
"""

import re
from dataclasses import dataclass

from orchestrator.model.messages import Refusal

REFUSALS = ("NG", "NG_I")
MODES = ("HOST", "HOST,PROGRAM", "HOST,MS", "MANUAL", "REMOTE", "TEACHING", "EDIT", "LOAD", "TEST")


@dataclass(frozen=True, slots=True)
class Form:
    """The form of a reply: its words for people, and the pattern, which is matched without blanks."""

    words: str
    pattern: re.Pattern[str]

    def fits(self, line: str) -> bool:
        return self.pattern.fullmatch(line) is not None


def _form(words: str, pattern: str) -> Form:
    return Form(words, re.compile(pattern))


DONE = _form("OK, OK_D, NG or NG_I", r"OK(_D)?|NG(_I)?")
ANYTHING = _form("any line", r".+")
MODE = _form("a mode", "|".join(MODES))
FORMAT = _form("SHOT_FC or HIT", r"SHOT_FC|HIT")
IDENTITY = _form("vendor,model,serial,firmware", r"[^,]+,[^,]+,[^,]+,[^,]+")
COMMAND = _form("the previous command", r"[^0-9].*")
CONTROLLABLE = _form("0 to 6", r"[0-6]")
BITS = _form("0 to 63", r"[0-5]?\d|6[0-3]")
SETTLING = _form("0 to 2550", r"\d{1,4}")
NOT_SET = _form("NS or a setting", r"NS|.+,.+")
READY = _form("R or B", r"[RB]")
STOPS = _form("X or K, how the axes have stopped, R or B", r"[XK],[123CDEWRK],[RB]")


def _status(axes: int) -> str:
    """As many coordinates as status words as states: what has lost a comma is another reply."""
    return ",".join(each for each in (r"[PNUMD]?[+-]?\d+(?:\.0*)?", "[0-9A-F]+", "[RBD]") for _ in range(axes))


STATUS = _form("coordinates, status words and states", "|".join(_status(axes) for axes in (1, 2, 3)))


def listed(pattern: str, count: int, words: str) -> Form:
    """A list of `count` entries that match `pattern`."""
    return _form(f"{count} of {words}", ",".join([f"(?:{pattern})"] * count))


def flags(count: int) -> Form:
    return listed("[01]", count, "0 or 1")


def amounts(count: int) -> Form:
    return listed(r"NS|[+-]?\d+(?:\.0*)?", count, "pulses or NS")


def triples(count: int) -> Form:
    return listed(r"S\d+F\d+R\d+", count, "SsFfRr")


def sizes(count: int) -> Form:
    return listed(r"\d+(?:\.\d+)?", count, "nm")


def entries(reply: str) -> list[int | None]:
    """The whole numbers of a list; None where nothing is set."""
    return [None if each == "NS" else int(float(each)) for each in reply.split(",")]


def triple(text: str) -> tuple[int, int, int]:
    """S, F (pls/s) and R (ms) of `SsFfRr`."""
    s, f, r = map(int, re.findall(r"\d+", text))
    return s, f, r


@dataclass(frozen=True, slots=True)
class AxisStatus:
    """One axis in a `Q:S` reply: coordinate (pls), status word, and R, B or D (ready, busy, not controllable)."""

    counts: int
    word: int
    state: str

    @property
    def busy(self) -> bool:
        return self.state == "B"


def status(reply: str, controllable: tuple[int, ...]) -> dict[int, AxisStatus]:
    """A `Q:SPC` reply by motor. An axis that is not controllable reads 0,0,D or is left out (L569, L581)."""
    fields = reply.split(",")
    count = len(fields) // 3
    motors = (1, 2, 3) if count == 3 else controllable
    return {
        motor: AxisStatus(int(float(fields[i].lstrip("PNUMD"))), int(fields[count + i], 16), fields[2 * count + i])
        for i, motor in enumerate(motors)
        if motor in controllable
    }


# Axes that a limit sensor has stopped, by the second letter of Q: and SRQ: (L432-L446). They are not the axis letters.
_LIMIT_STOPPED = {"1": {1}, "2": {2}, "3": {3}, "C": {1, 2}, "D": {1, 3}, "E": {2, 3}, "W": {1, 2, 3}}


def limit_stopped(reply: str) -> set[int]:
    """Motors whose last motion was ended by a limit sensor, from the reply to `SRQ:`; none is named after an error."""
    return _LIMIT_STOPPED.get(reply.split(",")[1], set())


def refusal(command: str) -> Refusal:
    """What to say of an `NG`."""
    return Refusal(
        code="refused",
        text=f"the controller answered NG to {command!r}",
        remedy="look at its display: an axis may be busy, its motor off, or another mode be chosen",
    )
