"""The program that lives in the controller: it waits behind a gate, and begins at a sample of the controller's own.

For each set of axes (bit 0 is X), because BG of an axis that is off is refused for all (L3071): an entry `#S<mask>` for
independent moves, and one `#C<mask>` that plays a contour out of the arrays. The gate polls XGO through a trip-point,
so that it costs the interpreter little, and is decided some samples before the start (see `gate.py`): in the last
milliseconds nothing but `WT` is under way, and BG or the first CD follows it on the same line with nothing between.
Contour mode is entered before.

A contour's records after the first follow in a loop whose next CD comes right after WC has let go (L11717), so that
the whole length of a record is there for it. `#DOG` runs beside a step in a thread of its own, from after its start to
its end: it stops the axes when nobody has moved XDL for too long, or when the program has died.

Names begin with X and no op-code, so that no assignment can be taken for a command (L15737).

    XT0    sample to begin after            XGO    1: the gate is open
    XARM   XT0, once the program waits      XOK    1: went through the gate in time
    XLATE  1: the gate was shut; no start   XACT   sample in which the begin had been carried out; 0 before
    XE1..4 sample in which an axis (of a contour: its first one, all of it) ended
    XDONE  1: all axes have ended
    XDL    sample in which the dog bites    XDOG   1: it has
    XN     records of full length           XM     all records
    XDT    DT of the full ones              XI     next record
    XLI    input to begin by, as AI takes it; 0: by XT0
    XLO    output to drive at XT0           XLV    its active level
    XLH    samples until it is passive again
    XC1..4 arrays: increments of an axis    XTD    array: DT of the records that are shorter
"""

from adapters.yaskawa.common.gate import STEP_TICKS, Gate
from adapters.yaskawa.common.record import AXIS_LETTERS

STEP_THREAD = 0
DOG_THREAD = 1
EDGE_THREAD = 3
DOG_STEP_TICKS = 32
LOOP_COMMANDS = 4  # a record's round: WC, CD, count, jump
TAIL_LENGTH = 8  # a tail has at most one record of each length below the full one

LINE_VARIABLES = ("XLI", "XLO", "XLV", "XLH")
RELEASE = "OB XLO,1-XLV"  # of the line; XLO is 0, and this refused, while none is driven
CONTOUR_VARIABLES = ("XN", "XM", "XDT", "XI")
VARIABLES = (
    *("XT0", "XGO", "XOK", "XARM", "XLATE", "XACT", "XDONE", "XE1", "XE2", "XE3", "XE4"),
    *("XDL", "XDOG", *LINE_VARIABLES, *CONTOUR_VARIABLES),
)
TAIL = "XTD"


def array(index: int) -> str:
    """The array of increments of an axis."""
    return f"XC{index + 1}"


def entry(mask: int, contour: bool) -> str:
    """The label that begins the axes of `mask`."""
    return f"#{'C' if contour else 'S'}{mask}"


def letters(mask: int) -> str:
    """The axes of `mask` as the controller writes them."""
    return "".join(letter for index, letter in enumerate(AXIS_LETTERS) if mask >> index & 1)


def program(axes: int, gate: Gate) -> tuple[str, ...]:
    """The program's lines for a controller of `axes` axes."""
    lines = ["#TUTTI;EN"]
    for mask in range(1 << axes):
        moving = letters(mask)
        begin = (f"BG{moving};" if moving else "") + "XACT=TIME"
        lines += [entry(mask, False), *_let_through(), f"JP #L{mask},XLI<>0", f"WT XT0-TIME;{begin}"]
        lines.append(f"#A{mask};XQ #DOG,{DOG_THREAD}")
        lines += [f"AM{letter};XE{AXIS_LETTERS.index(letter) + 1}=TIME" for letter in moving]
        lines += ["XDONE=1;EN", f"#L{mask};AI XLI;{begin};JP #A{mask}"]
    for mask in range(1, 1 << axes):
        lines += contour(mask, axes)
    lines += [
        *edge(),
        "#GATE;XOK=0;XLATE=0;XACT=0;XDONE=0;XARM=XT0",
        f"#HOLD;WT {STEP_TICKS};JP #HOLD,(XGO=0)&((XT0-TIME)>{gate.decided})",
        f"XOK=XGO&((XT0-TIME)>{gate.room})",
        "XLATE=1-XOK;EN",
        "#SHUT;EN",
        f"#DOG;WT {DOG_STEP_TICKS};JP #DOG,(TIME<XDL)&(_HX{STEP_THREAD}>0)",
        "JP #SHUT,XDONE=1",
        # The program first, or it would begin the contour anew.
        f"HX{STEP_THREAD};ST{letters((1 << axes) - 1)};XDOG=1;DT 0;CD 0;EN",
    ]
    return tuple(lines)


def _let_through() -> tuple[str, str]:
    return "JS #GATE", "JP #SHUT,XOK=0"


def contour(mask: int, axes: int) -> list[str]:
    """The lines that play the arrays of the axes of `mask`, of `axes` in all.

    Contour mode is left by DT 0 and CD 0 (L4274), which wait behind the last record like one.
    """
    chosen = [index for index in range(axes) if mask >> index & 1]

    def take(element: str) -> str:
        return "CD " + ",".join(f"{array(k)}[{element}]" if k in chosen else "" for k in range(chosen[-1] + 1))

    return [
        entry(mask, True),
        *_let_through(),
        f"CM {letters(mask)};DT XDT;XI=1",
        f"JP #K{mask},XLI<>0",
        f"WT XT0-TIME;{take('0')};XACT=TIME;XQ #DOG,{DOG_THREAD}",
        f"#P{mask};WC;{take('XI')};XI=XI+1;JP #P{mask},XI<XN",
        f"#T{mask};JP #U{mask},XI>=XM",
        f"WC;DT {TAIL}[XI-XN];{take('XI')};XI=XI+1;JP #T{mask}",
        f"#U{mask};WC;DT 0;CD 0",
        f"WC;XE{chosen[0] + 1}=TIME;XDONE=1;EN",
        f"#K{mask};AI XLI;{take('0')};XACT=TIME;XQ #DOG,{DOG_THREAD}",
        f"JP #P{mask}",
    ]


def edge() -> tuple[str, ...]:
    """The lines that drive a wired line: once the gate has let the step through, active at its sample, and passive
    again later. In a thread of its own, for BG follows the wait of the step's with nothing between."""
    return (
        f"#EDGE;WT {STEP_TICKS};JP #SHUT,XLATE=1;JP #EDGE,XOK=0",
        "WT XT0-TIME;OB XLO,XLV;WT XLH;OB XLO,1-XLV;EN",
    )
