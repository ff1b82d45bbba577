"""The resident program of an SMC-2000: it begins at a sample of the controller's own clock, and prints its state on
request.

Like the SMC-4000's (`program.py`: same variables, release gate, watchdog and contours), for a controller that takes
programs command by command and may have firmware that cannot combine conditions (L3997, L9594). Entries `#S<mask>`
begin the axes of a mask (bit 0 is X), one for each set of the axes that the fleet file names, because BG is refused for
all when one is off.

`#P` prints one line for a poll: started by `XQ#P,2`, which is much shorter than a query of the same values.
"""

from collections.abc import Iterable, Sequence
from itertools import combinations

from adapters.yaskawa.common.gate import GateTiming
from adapters.yaskawa.common.model import LEAVE_CONTOUR
from adapters.yaskawa.common.program import (
    CONTOUR_VARIABLES,
    LINE_VARIABLES,
    STEP_THREAD,
    TAIL,
    WATCHDOG_STEP_TICKS,
    WATCHDOG_THREAD,
    array_name,
    contour_lines,
    edge_lines,
    entry_label,
)
from adapters.yaskawa.common.program_turns import STEP_TICKS
from adapters.yaskawa.smc2000.session import ADDRESS

LETTERS = "XYZWEFGH"  # L1044-1048
INTERLEAVED_COMMANDS = 9  # commands: two more in a check of the gate, and commands of other threads on a serial line
POLL_COMMAND = "XQ#P,2"
HEADING = "#TUTTI"
AXES_MOST = 6  # the sets of more axes would need more than 254 labels (L3347)
# a contour's entry takes three more labels, and the program half a second of download for every six lines
CONTOUR_AXES_MOST = 4
AXIS_VALUES = 4  # RP, TE, TS, SC
INPUTS_OF_WORD = 8  # L11879
OUTPUTS_OF_WORD = 16  # L13420


def program_variables(axes: Sequence[int]) -> tuple[str, ...]:
    """Return the variables that the program reads or sets."""
    ends = (f"XE{index + 1}" for index in axes)
    return (
        "XT0",
        "XGO",
        "XOK",
        "XARM",
        "XLATE",
        "XACT",
        "XDONE",
        *ends,
        "XDL",
        "XDOG",
        *LINE_VARIABLES,
        *CONTOUR_VARIABLES,
    )


def supports_contours(axes: Sequence[int]) -> bool:
    """Return whether contours are supported for a controller with these axes."""
    return len(axes) <= CONTOUR_AXES_MOST


def contour_arrays(axes: Sequence[int]) -> tuple[str, ...]:
    """Return the names of all arrays that contours of these axes may use."""
    return (*(array_name(index) for index in axes), TAIL)


def printed_head(inputs: int, outputs: int, *, chained: bool) -> list[str]:
    """Return what is printed before the axes: address, sample counter, inputs and outputs in words."""
    return [
        *([ADDRESS] if chained else []),
        "TIME",
        *(f"_TI{bank}" for bank in range(inputs)),
        *(f"_OP{bank}" for bank in range(outputs)),
    ]


def program_lines(
    axes: Sequence[int], inputs: int, outputs: int, gate: GateTiming, *, chained: bool
) -> tuple[str, ...]:
    """Return the program's lines. axes: indices of the motors; inputs, outputs: how many words of them are printed."""
    return (
        *_start_lines(axes, gate),
        *_print_lines(axes, printed_head(chained=chained, inputs=inputs, outputs=outputs)),
    )


def _start_lines(axes: Sequence[int], gate: GateTiming) -> Iterable[str]:
    yield f"{HEADING};EN"
    for count in range(len(axes) + 1):
        for chosen in combinations(axes, count):
            begin = f"BG{''.join(LETTERS[index] for index in chosen)};" if chosen else ""
            mask = sum(1 << index for index in chosen)
            yield f"{entry_label(mask, contour=False)};JS#GATE;JP#SHUT,XOK=0;JP#L{mask},XLI<>0"
            yield f"WT XT0-TIME;{begin}XACT=TIME;JP#DONE"
            yield f"#L{mask};AI XLI;{begin}XACT=TIME;JP#DONE"
            if chosen and supports_contours(axes):
                yield from contour_lines(mask, chosen[-1] + 1)
    # An axis that does not move does not delay the others here.
    yield f"#DONE;XQ#DOG,{WATCHDOG_THREAD}"
    for index in axes:
        yield f"AM{LETTERS[index]};XE{index + 1}=TIME"
    yield "XDONE=1;EN"
    yield from edge_lines()
    yield "#GATE;XOK=0;XLATE=0;XACT=0;XDONE=0;XARM=XT0"
    yield f"#HOLD;WT {STEP_TICKS};JP#PASS,XGO=1;XR=XT0-TIME;JP#HOLD,XR>{gate.decided_before}"
    yield f"#PASS;XR=XT0-TIME;JP#LATE,XR<={gate.wait_after_gate};XOK=XGO"
    yield "#LATE;XLATE=1-XOK;EN"
    yield "#SHUT;EN"
    yield f"#DOG;WT {WATCHDOG_STEP_TICKS};JP#BITE,TIME>=XDL;JP#DOG,_HX{STEP_THREAD}>0"
    yield "JP#SHUT,XDONE=1"
    yield f"#BITE;HX{STEP_THREAD};ST{''.join(LETTERS[index] for index in axes)};XDOG=1;{';'.join(LEAVE_CONTOUR)};EN"


def _print_lines(axes: Sequence[int], first: Sequence[str]) -> Iterable[str]:
    yield "#P"
    groups = [first[at : at + AXIS_VALUES] for at in range(0, len(first), AXIS_VALUES)]
    groups += [[f"_{operand}{LETTERS[index]}" for operand in ("RP", "TE", "TS", "SC")] for index in axes]
    for number, group in enumerate(groups):
        comma = '",",' if number else ""
        values = ',",",'.join(f"{value}{{F10.0}}" for value in group)
        # The end of the line is sent once, with the last of them.
        yield f"MG {comma}{values}" + (";EN" if number == len(groups) - 1 else "{N}")
