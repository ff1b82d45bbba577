"""The program that lives in the controller: it waits behind a gate, and begins at a sample of the controller's own.

One entry `#S<mask>` for each set of axes (bit 0 is X), because BG of an axis that is off is refused for all (L3071).
The gate polls XGO through a trip-point, so that it costs the interpreter little, and is decided GATE_TICKS before the
start: in the last 20 ms nothing but `WT` is under way, and BG follows it on the same line with nothing between.
Names begin with X and no op-code, so that no assignment can be taken for a command (L15737).

    XT0    sample to begin after            XGO    1: the gate is open
    XARM   XT0, once the program waits      XOK    1: went through the gate in time
    XLATE  1: the gate was shut; no start   XACT   sample in which BG had been carried out; 0 before
    XE1..4 sample in which an axis ended    XDONE  1: all axes have ended
"""

from adapters.yaskawa.record import AXIS_LETTERS

GATE_TICKS = 40
GATE_STEP_TICKS = 4
# At most so long after it opens, the program has seen it: one round of the loop, at half a millisecond a command.
GATE_SEEN_TICKS = GATE_STEP_TICKS + 6
START_ROOM_TICKS = 8  # from the gate to the wait there are four commands

VARIABLES = ("XT0", "XGO", "XOK", "XARM", "XLATE", "XACT", "XDONE", "XE1", "XE2", "XE3", "XE4")


def entry(mask: int) -> str:
    """The label that begins the axes of `mask`."""
    return f"#S{mask}"


def letters(mask: int) -> str:
    """The axes of `mask` as the controller writes them."""
    return "".join(letter for index, letter in enumerate(AXIS_LETTERS) if mask >> index & 1)


def program(axes: int) -> tuple[str, ...]:
    """The program's lines for a controller of `axes` axes."""
    lines = ["#TUTTI;EN"]
    for mask in range(1 << axes):
        moving = letters(mask)
        begin = f"BG{moving};" if moving else ""
        lines += [entry(mask), "JS #GATE", "JP #SHUT,XOK=0", f"WT XT0-TIME;{begin}XACT=TIME"]
        lines += [f"AM{letter};XE{AXIS_LETTERS.index(letter) + 1}=TIME" for letter in moving]
        lines.append("XDONE=1;EN")
    lines += [
        "#GATE;XOK=0;XLATE=0;XACT=0;XDONE=0;XARM=XT0",
        f"#HOLD;WT {GATE_STEP_TICKS};JP #HOLD,(XGO=0)&((XT0-TIME)>{GATE_TICKS})",
        f"XOK=XGO&((XT0-TIME)>{START_ROOM_TICKS})",
        "XLATE=1-XOK;EN",
        "#SHUT;EN",
    ]
    return tuple(lines)
