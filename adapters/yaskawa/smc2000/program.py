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

from adapters.yaskawa.common.gate import BEGIN_TICKS, FOLLOWING_STEP_TICKS, LAST_LOOK_TICKS, STEP_TICKS, GateTiming
from adapters.yaskawa.common.program import (
    BEGIN_VARIABLE,
    CONTOUR_VARIABLES,
    EDGE_THREAD,
    FOLLOWING_VARIABLES,
    LINE_VARIABLES,
    OUTPUT_PASSIVE,
    PULSE_LABEL,
    REGISTER_VARIABLES,
    STEP_THREAD,
    TABLE,
    TABLE_VARIABLES,
    TAIL,
    WATCHDOG_STEP_TICKS,
    WATCHDOG_THREAD,
    array_name,
    contour_lines,
    edge_lines,
    entry_label,
    following_label,
    register_commands,
    sum_of_distances,
    take_lines,
)
from adapters.yaskawa.shapes.model import LEAVE_CONTOUR
from adapters.yaskawa.smc2000.selection import ADDRESS

LETTERS = "XYZWEFGH"  # L1044-1048
INTERLEAVED_COMMANDS = 9  # commands: two more in a check of the gate, and commands of other threads on a serial line
POLL_COMMAND = "XQ#P,2"
STEP_THREADS = (STEP_THREAD, EDGE_THREAD)  # a step that follows another one runs beside no trigger line
HEADING = "#TUTTI"
AXES_MOST = 6  # the sets of more axes would need more than 254 labels (L3347)
# a contour's entry takes three more labels, and the program half a second of download for every six lines
CONTOUR_AXES_MOST = 4
# The entry of a step that follows another one takes four labels, and nine lines.
FOLLOWING_AXES_MOST = 3
# Before an element of the table of triggers: a wait is computed and begun within this many samples, with a command of
# each other thread and of the host in between.
NEAR_TICKS = 8
PULSE_COMMANDS, LEVEL_COMMANDS = 13, 12  # of one round of its triggers, the wait and the sum counted twice
WATCHDOG_COMMANDS = 6  # of one look
HOST_COMMANDS = 3  # in one round of its triggers
TRIGGER_BESIDE = 4  # threads alternate command by command: one of each other thread, and one of the host
AXIS_VALUES = 4  # RP, TE, TS, SC
INPUTS_OF_WORD = 8  # L11879
OUTPUTS_OF_WORD = 16  # L13420
_PART_CHARACTERS = 240  # of a program per turn: other controllers of a chain wait an eighth of a second for their turn


def program_variables(axes: Sequence[int], *, chained: bool) -> tuple[str, ...]:
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
        *TABLE_VARIABLES,
        "XRA",
        *CONTOUR_VARIABLES,
        *(_following_variables(axes) if holds_following_steps(axes, chained=chained) else ()),
    )


def _following_variables(axes: Sequence[int]) -> Iterable[str]:
    names = (*REGISTER_VARIABLES.values(), BEGIN_VARIABLE, "XZ")
    return (*FOLLOWING_VARIABLES, "XFR", *(f"{name}{index + 1}" for name in names for index in axes))


def holds_following_steps(axes: Sequence[int], *, chained: bool) -> bool:
    """Return whether a step can be loaded behind another one for a controller with these axes: its entries take four
    labels each. On a daisy chain, loading would take the line from the watchdogs of the controllers that move."""
    return len(axes) <= FOLLOWING_AXES_MOST and not chained


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
        *_start_lines(axes, gate, follows=holds_following_steps(axes, chained=chained)),
        *_print_lines(axes, printed_head(chained=chained, inputs=inputs, outputs=outputs)),
    )


def _start_lines(axes: Sequence[int], gate: GateTiming, *, follows: bool) -> Iterable[str]:
    yield f"{HEADING};EN"
    for count in range(len(axes) + 1):
        for chosen_axes in combinations(axes, count):
            begin = f"BG{''.join(LETTERS[index] for index in chosen_axes)};" if chosen_axes else ""
            mask = sum(1 << index for index in chosen_axes)
            yield f"{entry_label(mask, contour=False)};JS#GATE;JP#SHUT,XOK=0;JP#L{mask},XLI<>0"
            yield f"WT XT0-TIME;{begin}XACT=TIME;JP#DONE"
            yield f"#L{mask};AI XLI;{begin}XACT=TIME;JP#DONE"
            if chosen_axes and supports_contours(axes):
                yield from contour_lines(mask, chosen_axes[-1] + 1, ring=False)
            if chosen_axes and follows:
                yield from _following_lines(chosen_axes, axes)
    # An axis that does not move does not delay the others here. The watchdog of the step before may still run.
    yield f"#DONE;HX{WATCHDOG_THREAD};XQ#DOG,{WATCHDOG_THREAD}"
    for index in axes:
        yield f"AM{LETTERS[index]};XE{index + 1}=TIME"
    yield "XDONE=1;EN"
    yield from edge_lines()
    yield from _trigger_lines()
    yield from take_lines(axes) if follows else ()
    yield "#GATE;XOK=0;XLATE=0;XACT=0;XDONE=0;XARM=XT0"
    yield f"#HOLD;WT {STEP_TICKS};JP#PASS,XGO=1;XR=XT0-TIME;JP#HOLD,XR>{gate.decided_before}"
    yield f"#PASS;XR=XT0-TIME;JP#LATE,XR<={gate.wait_after_gate};XOK=XGO"
    yield "#LATE;XLATE=1-XOK;EN"
    yield "#SHUT;EN"
    yield f"#DOG;WT {WATCHDOG_STEP_TICKS};JP#BITE,TIME>=XDL"
    yield ";".join(f"JP#DOG,_HX{thread}>0" for thread in STEP_THREADS)
    yield "JP#SHUT,XDONE=1"
    halts = ";".join(f"HX{thread}" for thread in STEP_THREADS)
    letters = "".join(LETTERS[index] for index in axes)
    yield f"#BITE;{halts};ST{letters};XDOG=1"
    yield f"JP#LEAVE,XLO=0;{OUTPUT_PASSIVE}"
    yield f"#LEAVE;{';'.join(LEAVE_CONTOUR)};EN"


def _trigger_lines() -> Iterable[str]:
    """Return the lines that switch an output at the samples of a table, like the SMC-4000's `trigger_lines`: pulses, or
    changes of its level where XLH is 0.

    Conditions are no terms of expressions here (L9594), and WT of a negative time would end the program: an element
    that is near is waited for by the counter. XRA: the sample before which it is far.
    """
    yield f"{PULSE_LABEL};WT {STEP_TICKS};JP#SHUT,XLATE=1;JP{PULSE_LABEL},XOK=0"
    yield f"#NEXT;XRA=XT0+{TABLE}[XRI]-{NEAR_TICKS};JP#SOON,TIME>=XRA;WT XRA-TIME+{NEAR_TICKS}"
    yield f"#PLAY;{TABLE}[XRI]=TIME;OB XLO,XRV;JP#TURN,XLH=0"
    yield "WT XLH;OB XLO,1-XLV;JP#MORE"
    yield "#TURN;XRV=1-XRV"
    yield "#MORE;XRI=XRI+1;JP#NEXT,XRI<XRN"
    yield "OB XLO,1-XLV;XLO=0;EN"
    yield f"#SOON;XRA=XRA+{NEAR_TICKS}"
    yield "#SPIN;JP#SPIN,TIME<XRA;JP#PLAY"


def _following_lines(chosen: Sequence[int], axes: Sequence[int]) -> Iterable[str]:
    """Return the lines of the axes `chosen` as a step that follows another one, like the SMC-4000's."""
    mask = sum(1 << index for index in chosen)
    letters, everything = ("".join(LETTERS[index] for index in indices) for indices in (chosen, axes))
    position, speed, up, down = register_commands(chosen)
    look = f"XFR=XFT-TIME;JP#{{}}{mask},XFR>{LAST_LOOK_TICKS}"
    yield f"{following_label(mask)};XFARM=XFT"
    yield f"#G{mask};WT {FOLLOWING_STEP_TICKS};JP#B{mask},XACT>0;{look.format('G')}"
    yield f"#B{mask};AM{everything}"
    yield f"{position};{speed}"
    yield f"{up};{down}"
    yield f"#H{mask};JP#R{mask},XFGO=1;WT {FOLLOWING_STEP_TICKS};{look.format('H')}"
    yield f"#R{mask};XOFF={sum_of_distances(axes, LETTERS)}"
    yield f"JP#MISS,XFGO=0;JP#MISS,XDONE=0;JP#MISS,XOFF>0;XFR=XFT-TIME;JP#MISS,XFR<={BEGIN_TICKS}"
    yield f"WT XFT-TIME;BG{letters};XFA=TIME"
    yield "JS#TAKE;JP#DONE"


def _print_lines(axes: Sequence[int], first: Sequence[str]) -> Iterable[str]:
    yield "#P"
    groups = [first[at : at + AXIS_VALUES] for at in range(0, len(first), AXIS_VALUES)]
    groups += [[f"_{operand}{LETTERS[index]}" for operand in ("RP", "TE", "TS", "SC")] for index in axes]
    for number, group in enumerate(groups):
        comma = '",",' if number else ""
        values = ',",",'.join(f"{value}{{F10.0}}" for value in group)
        # The end of the line is sent once, with the last of them.
        yield f"MG {comma}{values}" + (";EN" if number == len(groups) - 1 else "{N}")


def split_program(lines: tuple[str, ...]) -> list[tuple[str, ...]]:
    """Split a program's lines into parts between which other controllers of a chain get their turns."""
    parts: list[tuple[str, ...]] = [()]
    for line in lines:
        if sum(map(len, (*parts[-1], line))) > _PART_CHARACTERS:
            parts.append(())
        parts[-1] += (line,)
    return parts
