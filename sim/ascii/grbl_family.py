"""What differs between the firmwares of GRBL's family: GRBL 1.1h (https://github.com/gnea/grbl) and grblHAL 1.1f
(https://github.com/grblHAL/core, 20260817).

Texts are those that the firmwares send, run on a PC; fields of the status that come and go (WCO, Ov, A, H, TLR) are
left out.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass

from orchestrator.model.errors import TuttiError

AXES = ("X", "Y", "Z")
_WORD = re.compile(r"([A-Z])([-+]?(?:\d+\.?\d*|\.\d+))")
_GCODES = {"G0", "G1", "G17", "G21", "G53", "G54", "G90", "G94"}  # of the blocks that move here; others are refused
_MCODES = {"M5", "M9"}  # those that change nothing here


class GrblRefusal(TuttiError):
    """A line that is answered `error:` with a number (report.h)."""

    def __init__(self, number: int) -> None:
        super().__init__(str(number))
        self.number = number


@dataclass(frozen=True, slots=True)
class GrblFamily:
    """One firmware. identity: the reply to `$I`. rx_bytes: free bytes of the empty receive buffer. blocks: of the empty
    planner. bytes_at_once: bytes that act at once, as the character that they stand for; others above 7Fh are dropped.
    modes: in the reply to `$G`. shows_tool: `T` is shown until the next line of G-code; otherwise it only selects.
    speed_end: behind the spindle speed. feed: at the end of a status. unlocked: before the reply to `$X`.
    message: before the replies to `$H` and to the start of a held line. scale_decimals: of the steps per mm in `$$`."""

    greeting: str
    identity: str
    rx_bytes: int
    blocks: int
    bytes_at_once: Mapping[int, int]
    modes: str
    shows_tool: bool
    speed_end: str
    feed: str
    unlocked: str
    message: str
    scale_decimals: int

    def format_modes(self, values: Mapping[str, float]) -> str:
        """The reply to `$G`. values: of T, F and S; with F, a line has moved since the last reset."""
        mode = "G1" if values["F"] else "G0"
        words = " ".join(f"{name}{values[name]:.0f}" for name in "TFS")
        return f"[GC:{mode} {self.modes} {words}{self.speed_end}]\r\n"


GRBL = GrblFamily(
    greeting="\r\nGrbl 1.1h ['$' for help]\r\n",
    identity="[VER:1.1h.20190830:]\r\n[OPT:V,15,128]\r\n",
    rx_bytes=128,
    blocks=15,
    bytes_at_once={byte: byte for byte in (0x3F, 0x21, 0x7E, 0x18, 0x85)},
    modes="G54 G17 G21 G90 G94 M5 M9",
    shows_tool=True,
    speed_end="",
    feed="|FS:0,0",
    unlocked="[MSG:Caution: Unlocked]\r\n",
    message="",
    scale_decimals=3,
)
GRBLHAL = GrblFamily(
    greeting="\r\nGrblHAL 1.1f ['$' or '$HELP' for help]\r\n",
    identity="[VER:1.1f.20260817:]\r\n[OPT:VNML+,100,1024,3,0]\r\n[AXS:3:XYZ]\r\n[NEWOPT:ENUMS,RT+,TC,SED]\r\n"
    "[FIRMWARE:grblHAL]\r\n[SIGNALS:D]\r\n[NVS STORAGE:*EEPROM]\r\n[DRIVER:Simulator]\r\n[DRIVER VERSION:260324]\r\n",
    rx_bytes=1023,
    blocks=100,
    bytes_at_once={**GRBL.bytes_at_once, 0x80: 0x3F, 0x81: 0x7E, 0x82: 0x21},
    modes="G54 G17 G21 G90 G94 G40 G49 G98 G50 M5 M9",
    shows_tool=False,
    speed_end=".",
    feed="",
    unlocked="",
    message="[MSG:]\r\n",
    scale_decimals=5,
)


def format_setting(family: GrblFamily, number: int, value: float) -> str:
    """A line of the reply to `$$`."""
    if 100 <= number < 110:
        return f"${number}={value:.{family.scale_decimals}f}\r\n"
    return f"${number}={value:.{3 if number >= 100 or number in (11, 12, 24, 25, 27) else 0}f}\r\n"


def read_words(text: str) -> dict[str, float]:
    """Return axis words, F, S and T of a block. Codes that it does not use here are refused (`GrblRefusal`)."""
    if "".join(f"{letter}{number}" for letter, number in _WORD.findall(text)) != text:
        raise GrblRefusal(1)
    values: dict[str, float] = {}
    for letter, number in _WORD.findall(text):
        if letter in "GM":
            if f"{letter}{float(number):g}" not in _GCODES | _MCODES:
                raise GrblRefusal(20)
        elif letter in (*AXES, "F", "S", "T"):
            if letter in values:
                raise GrblRefusal(25)
            values[letter] = float(number)
        else:
            raise GrblRefusal(20)
    if min(values.get("S", 0.0), values.get("T", 0.0)) < 0:
        raise GrblRefusal(4)
    return values
