"""EDS files of the shapes that drives of several makers have, made from that of the simulated drive: objects that are
missing, that no PDO carries or that cannot be written, PDOs that are few, small or fixed."""

import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

from sim import cia402

EDS = Path(cia402.__file__).with_name("drive.eds")
Edit = Callable[[str], str]

STANDARD_MAPPING = {
    "1600": ("60400010",),
    "1601": ("60400010", "60600008"),
    "1602": ("60400010", "607A0020"),
    "1603": ("60400010", "60FF0020"),
    "1A00": ("60410010",),
    "1A01": ("60410010", "60610008"),
    "1A02": ("60410010", "60640020"),
    "1A03": ("60410010", "606C0020"),
}
"""The default mapping of CiA 402-3."""


def without(*objects: str) -> Edit:
    """Leave objects out, by index or as `1A00sub2`."""

    def edit(text: str) -> str:
        for name in objects:
            section = name if "sub" in name else name + r"(sub\w+)?"
            text = re.sub(rf"(?s)\[{section}\].*?(?=\n\[|$)", "", text)
            text = re.sub(rf"\n\d+=0x{name}\b", "", text, flags=re.IGNORECASE)
        return text

    return edit


def with_entry(sections: Sequence[str], key: str, value: str) -> Edit:
    """Change an entry in sections, e.g. `PDOMapping` in 6061."""

    def edit(text: str) -> str:
        for section in sections:
            pattern = rf"(?s)(\[{section}\](?:(?!\n\[).)*?\n{key}=)[^\n]*"
            text, count = re.subn(pattern, lambda match: match[1] + value, text)
            assert count == 1, (section, key)
        return text

    return edit


def with_fixed_mapping(mapping: Mapping[str, Sequence[str]]) -> Edit:
    """Fix what PDOs carry, by the index of their mapping."""
    edits: list[Edit] = []
    for index, entries in mapping.items():
        edits.append(with_entry([f"{index}sub0"], "DefaultValue", f"{len(entries)}"))
        edits.append(with_entry([f"{index}sub{number}" for number in range(9)], "AccessType", "const"))
        edits += [
            with_entry([f"{index}sub{number}"], "DefaultValue", f"0x{entry}")
            for number, entry in enumerate(entries, start=1)
        ]
    return lambda text: apply(text, edits)


def apply(text: str, edits: Sequence[Edit]) -> str:
    for edit in edits:
        text = edit(text)
    return text


COB_IDS = {
    "1400sub1": "0x200",
    "1401sub1": "0x300",
    "1402sub1": "0x400",
    "1403sub1": "0x500",
    "1800sub1": "0x180",
    "1801sub1": "0x280",
    "1802sub1": "0x380",
    "1803sub1": "0x480",
}
"""The predefined identifiers, of all PDOs switched on."""
SHAPES: Mapping[str, Sequence[Edit]] = {
    "one ramp for both": [without("6084", "1016")],
    "actual position only": [without("6062", "60FD")],
    "mode by SDO": [
        with_entry(["6061"], "PDOMapping", "0"),
        with_entry(list(COB_IDS), "AccessType", "ro"),
        *(with_entry([section], "DefaultValue", f"$NODEID+{cob}") for section, cob in COB_IDS.items()),
        without("60FE"),
    ],
    "profile by SDO": [with_entry(["607A", "6081", "6083"], "PDOMapping", "0")],
    "fixed standard mapping": [with_fixed_mapping(STANDARD_MAPPING)],
    "small PDOs": [
        without("6084", "60FD", "605A", "605D", "607D", "60C2"),
        with_entry(["6060"], "AccessType", "wo"),
        without(*(f"{index}sub{number}" for index in ("1600", "1A00") for number in range(2, 9))),
    ],
    "two RPDOs": [
        without("1402", "1602", "1403", "1603", "6084", "6085", "605A", "605D", "6099", "609A"),
        with_entry(["6098"], "AccessType", "const"),
        with_entry(["6098"], "DefaultValue", "37"),
    ],
    "no homing": [without("6098", "6099", "609A", "60FD", "60FE", "6086")],
}
"""Shapes that suffice for moves without `jerk`."""
OTHER_MAPPING = {"1600": ("60400010", "60FF0020")}
REFUSED: Mapping[str, tuple[Sequence[Edit], str]] = {
    "fixed mapping for velocities": (
        [with_fixed_mapping(OTHER_MAPPING)],
        "the mapping of RPDO 1 is fixed to controlword (6040h:00), another object (60FFh:00)",
    ),
    "one RPDO": (
        [without("1401", "1601", "1402", "1602", "1403", "1603", "6084", "60FD")],
        "one RPDO, two are needed: no RPDO 2 (1401h, 1601h)",
    ),
    "mode not in a PDO": (
        [with_entry(["6060"], "PDOMapping", "0"), with_entry(["1601sub0"], "DefaultValue", "0")],
        "RPDO 2 cannot carry modes of operation (6060h:00)",
    ),
    "fixed start": (
        [with_entry(["1400sub2"], "AccessType", "const"), with_entry(["1400sub2"], "DefaultValue", "255")],
        "the transmission type of RPDO 1 is fixed to 255; needed is 1",
    ),
}
"""Shapes that do not suffice, each with the words of its refusal."""


def write_shape(folder: Path, edits: Sequence[Edit]) -> str:
    """Write the EDS file of a shape; return its path."""
    path = folder / "drive.eds"
    path.write_text(apply(EDS.read_text(), edits))
    return str(path)
