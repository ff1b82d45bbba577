"""The codes that are read: by modal group, with what each needs; and what stands in each dialect."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

Meaning = Literal["read", "skipped", "spindle", "tools", "coolant", "pause"]


class Code(NamedTuple):
    """A code. group: of which a line has one; meaning: what it does, or the entry of `gcode:` that it needs."""

    name: str
    group: str
    meaning: Meaning = "read"


def _list_codes(group: str, names: str, meaning: Meaning = "read") -> dict[tuple[str, float], Code]:
    return {(name[0], float(name[1:])): Code(name, group, meaning) for name in names.split()}


CODES: Mapping[tuple[str, float], Code] = {
    **_list_codes("motion", "G0 G1 G2 G3 G38.2 G38.3 G38.4 G38.5 G73 G81 G82 G83 G85 G89"),
    # Alone it ends a motion; beside G0 or G1, as many controls have it, it ends a cycle.
    **_list_codes("cycle end", "G80"),
    **_list_codes("dwell", "G4"),
    **_list_codes("axes", "G10 G28 G30 G52 G92 G92.1 G92.2 G92.3"),
    **_list_codes("machine", "G53"),
    **_list_codes("plane", "G17 G18 G19"),
    **_list_codes("units", "G20 G21"),
    **_list_codes("distance", "G90 G91"),
    **_list_codes("arc distance", "G90.1 G91.1"),
    **_list_codes("feed mode", "G93 G94 G95"),
    **_list_codes("cutter", "G40", "skipped"),
    **_list_codes("length", "G43", "tools"),
    **_list_codes("length", "G43.1 G49"),
    **_list_codes("return", "G98 G99"),
    **_list_codes("system", "G54 G55 G56 G57 G58 G59 G59.1 G59.2 G59.3"),
    **_list_codes("control", "G61 G61.1 G64"),
    **_list_codes("spindle mode", "G97", "skipped"),
    **_list_codes("end", "M2 M30"),
    **_list_codes("end", "M0 M1 M60", "pause"),
    **_list_codes("spindle", "M3 M4 M5", "spindle"),
    **_list_codes("tool", "M6", "tools"),
    **_list_codes("mist", "M7", "coolant"),
    **_list_codes("flood", "M8", "coolant"),
    **_list_codes("coolant", "M9", "skipped"),
    **_list_codes("override", "M48", "skipped"),
}

# Why a code is refused that other programs have; others are not known.
_COMPENSATION = "offsets the path by the radius of a tool; have the CAM program compensate it"
REASONS: Mapping[str, str] = {
    "G38": "is G38.2 to G38.5: toward a contact, or away from it",
    **dict.fromkeys(("G41", "G42", "G41.1", "G42.1"), _COMPENSATION),
    **dict.fromkeys(("G33", "G33.1", "G76", "G84", "G74"), "follows the angle of a spindle"),
    **dict.fromkeys(("G86", "G87", "G88"), "stops the spindle, or waits for a person, inside of a hole"),
    **dict.fromkeys(("G28.1", "G30.1"), "stores a place in a controller; write it as `gcode: {offsets: {G28: […]}}`"),
    **dict.fromkeys(("G7", "G8", "G96"), "is for lathes"),
    **dict.fromkeys(("G5", "G5.1", "G5.2"), "is a spline; have the CAM program write arcs or lines"),
    **dict.fromkeys(("M62", "M63", "M64", "M65", "M66", "M67", "M68"), "switches, or waits for, a pin of LinuxCNC"),
    **dict.fromkeys(("M98", "M99"), "calls another program; write it out, or as an O word of LinuxCNC"),
    **dict.fromkeys(("G29", "G32", "G33"), "measures a bed"),
    "M49": "forbids to change the speed of a path, which a person may always do",
}
PROBING = frozenset({"G38.2", "G38.3", "G38.4", "G38.5"})
CYCLES = frozenset({"G73", "G81", "G82", "G83", "G85", "G89"})


@dataclass(frozen=True, slots=True)
class Dialect:
    """What differs in a dialect. missing: codes that it does not have; extra: those that it alone has.

    dwell: seconds of a unit of each word that G4 may have; has_flow: whether it has O words, parameters and
    expressions; is_integer_small: whether a number without a point may be in steps of 0.001; has_rapids: whether G0 is
    faster than the feed.
    """

    name: str
    missing: frozenset[str] = frozenset()
    extra: Mapping[tuple[str, float], Code] = field(default_factory=dict[tuple[str, float], Code])
    dwell: Mapping[str, float] = field(default_factory=dict[str, float])
    has_flow: bool = False
    is_integer_small: bool = False
    has_rapids: bool = True


_OF_LINUXCNC = frozenset(
    CYCLES | {"G98", "G99", "G64", "G61.1", "G90.1", "G92.2", "G92.3"} | {"G52", "G59.1", "G59.2", "G59.3"}
)
_MARLIN = {
    **_list_codes("skipped 1", "M82 M83 M400", "skipped"),
    **_list_codes("flood", "M106", "coolant"),
    **_list_codes("coolant", "M107", "skipped"),
}
DIALECTS: Mapping[str, Dialect] = {
    dialect.name: dialect
    for dialect in (
        Dialect("linuxcnc", dwell={"P": 1.0}, has_flow=True),
        Dialect("grbl", missing=_OF_LINUXCNC | {"G95", "G97", "M6", "M60", "M48"}, dwell={"P": 1.0}),
        Dialect(
            "marlin",
            missing=_OF_LINUXCNC | {"G95", "G97", "G93", "M6", "M60", "M48", "G10", "G43", "G43.1", "G49", "G30"},
            extra=_MARLIN,
            dwell={"P": 0.001, "S": 1.0},
            has_rapids=False,
        ),
        Dialect("fanuc", missing=PROBING, dwell={"P": 0.001, "X": 1.0, "U": 1.0}, is_integer_small=True),
    )
}


def find_code(dialect: Dialect, letter: str, value: float) -> Code | None:
    """The code of a G or M word; None: it is refused."""
    key = (letter, round(value, 1) if abs(value - round(value, 1)) < 1e-6 else value)
    code = dialect.extra.get(key) or CODES.get(key)
    return None if code is None or code.name in dialect.missing else code


def explain_refusal(dialect: Dialect, name: str) -> str:
    """Why a code is refused, in words."""
    if name in dialect.missing:
        return (
            f"{name} is no code of {dialect.name}; if the program is of another dialect, write `gcode: {{dialect: …}}`"
        )
    reason = REASONS.get(name)
    return f"{name} is not supported: it {reason}" if reason else f"{name} is not supported"
