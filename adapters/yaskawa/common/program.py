"""The resident program of the controller: it waits at a release gate, and begins at a sample of the controller's own
clock.

Each set of axes (bit 0 is X) has its own entry, because BG is refused for all axes when one of them is off (L3071):
`#S<mask>` for independent moves, and `#C<mask>` that plays a contour out of the arrays. The release gate polls XGO
through a trip-point, so that it costs the interpreter little, and is decided some samples before the start (see
`gate.py`): in the last milliseconds only `WT` is active, and BG or the first CD follows it on the same line with
nothing in between. Contour mode is entered before.

A contour's records after the first follow in a loop whose next CD comes immediately after WC has passed (L11717), so
that the whole length of a record is available for it. The loop reads a ring of XW + 1 elements up to record XN, which
the host raises while it runs: a contour may be longer than the arrays. Its end is in elements of their own, behind the
ring: records of full length, then shorter ones. Where XN is not raised in time, that end brakes the axes to rest.

`#DOG`, the watchdog, runs in a thread of its own from after the start of a step to its end, and to that of its
triggers: it stops the axes and makes the output passive when the deadline XDL has not been extended in time, or when
the program has died.

A step that follows the present one (`#F<mask>`) waits in the other of two threads: for the end of the present one, then
at its own release, with its registers loaded; and begins at its sample if all axes are where the present one was to end
(`@ABS` of the differences, so that a limit switch or a stop leaves it waiting for ever). Only after its begin are the
variables of the present step kept in XZ.. and those of the following one put in their place.

A step that no other controller depends on (`#O<mask>`; with the speeds and ramps of the step before `#Q<mask>`) waits
in the same way, for its release and for the end, and begins without a sample of its own.

Names begin with X, which begins no op-code, so that no assignment can be mistaken for a command (L15737).

    XT0    sample after which to begin      XGO    1: the gate is open
    XARM   XT0, once the program waits      XOK    1: passed the gate in time
    XLATE  1: the gate was shut; no start   XACT   sample in which the begin had been executed; 0 before
    XE1..4 sample in which an axis (of a contour: its first one, all of it) ended
    XDONE  1: all axes have ended
    XDL    sample of the watchdog deadline  XDOG   1: the watchdog has fired
    XN     records that the ring gives      XI     next one of them
    XW     mask of the ring                 XDT    DT of records of full length
    XTB    first element of the end         XJ     next one of it
    XV     behind its full records          XM     behind all of it
    XFT    XT0 of the following step        XFGO   1: it is released
    XFARM  XFT, once it waits               XFL    1: it was not started
    XFA    its XACT                         XOFF   counts that axes are off the end of the present step
    XP1..4 its targets                      XS1..4 its speeds
    XU1..4 its accelerations                XW1..4 its decelerations
    XB1..4 where it begins, of all axes     XZT, XZA, XZ1..4  XT0, XACT, XE1..4 of the step before
    XLI    input to begin by, as AI takes it; 0: by XT0
    XLO    output to drive at XT0           XLV    its active level
    XLH    samples until it is passive again
    XIN    counts to move farther           XIT    sample before which that is possible
    XRN    triggers of the table            XRI    the next one
    XRV    level that it sets the output to XRT    array: samples after XT0, then the stamps
    XRM    mask of it as a ring             XRF    samples before which a trigger is far
    XRE    1: the ring ends where it is
    XKI    input that ends a probe, as AI takes it; 0: there is no probe
    XKT    sample after its edge; 0 before  XK1..4 positions of encoders before that, one after the other
    XC1..4 arrays: increments of an axis    XTD    array: DT of the records that are shorter
"""

from collections.abc import Iterable, Sequence

from adapters.yaskawa.common.gate import (
    BEGIN_TICKS,
    FOLLOWING_STEP_TICKS,
    LAST_LOOK_TICKS,
    SHORT_CHECK_AXES,
    STEP_TICKS,
    GateTiming,
)
from adapters.yaskawa.language.dialect import MAX_LINE
from adapters.yaskawa.wire.record import AXIS_LETTERS

STEP_THREAD = 0
WATCHDOG_THREAD = 1
SECOND_STEP_THREAD = 2  # a step that follows another one runs in the thread that the other one does not use
STEP_THREADS = (STEP_THREAD, SECOND_STEP_THREAD)
EDGE_THREAD = 3
WATCHDOG_STEP_TICKS = 32
LOOP_COMMANDS = 4  # one round per record: WC, CD, count, jump; one more, once, where the end begins
TAIL_LENGTH = 8  # a tail has at most one record of each length below the full one

LINE_VARIABLES = ("XLI", "XLO", "XLV", "XLH")
TABLE = "XRT"  # of triggers
TABLE_VARIABLES = ("XRN", "XRI", "XRV")
RING_VARIABLES = ("XRM", "XRF", "XRE")
PROBE_INPUT, PROBE_TIME = "XKI", "XKT"
LINE_PROBE_LABEL = "#LPROBE"
PULSE_LABEL, LEVEL_LABEL = "#PULSE", "#LEVEL"
RING_PULSE_LABEL, RING_LEVEL_LABEL = "#RPULSE", "#RLEVEL"
FAR_TICKS = 8  # from one look for the next trigger of a ring to another
OUTPUT_PASSIVE = "OB XLO,1-XLV"  # of the trigger line; XLO is 0, and this command refused, while no line is driven
CONTOUR_VARIABLES = ("XN", "XM", "XDT", "XI", "XW", "XTB", "XV", "XJ")
REGISTER_VARIABLES = {"PA": "XP", "SP": "XS", "AC": "XU", "DC": "XW"}
BEGIN_VARIABLE = "XB"
FOLLOWING_VARIABLES = ("XFT", "XFGO", "XFARM", "XFL", "XFA", "XFOK", "XOFF", "XZT", "XZA")
VARIABLES = (
    *("XT0", "XGO", "XOK", "XARM", "XLATE", "XACT", "XDONE", "XE1", "XE2", "XE3", "XE4"),
    *("XDL", "XDOG", *LINE_VARIABLES, *TABLE_VARIABLES, *RING_VARIABLES, PROBE_INPUT, PROBE_TIME),
    *CONTOUR_VARIABLES,
    *FOLLOWING_VARIABLES,
    *(
        f"{name}{number}"
        for name in (*REGISTER_VARIABLES.values(), BEGIN_VARIABLE, "XZ", "XK")
        for number in range(1, 5)
    ),
)
TAIL = "XTD"


def array_name(index: int) -> str:
    """Return the array of increments of an axis."""
    return f"XC{index + 1}"


def entry_label(mask: int, *, contour: bool) -> str:
    """Return the label that begins the axes of `mask`."""
    return f"#{'C' if contour else 'S'}{mask}"


def following_label(mask: int) -> str:
    """Return the label of the axes of `mask` as a step that follows another one."""
    return f"#F{mask}"


def at_once_label(mask: int, *, quick: bool) -> str:
    """Return the label of the axes of `mask` as a step that begins as soon as the one before has ended. quick: with the
    speeds and ramps of that one."""
    return f"#{'Q' if quick else 'O'}{mask}"


def probe_label(index: int) -> str:
    """Return the label that begins a probe of an axis."""
    return f"#PROBE{index + 1}"


def probe_position(index: int) -> str:
    """Return the variable that has the position of an axis at the contact."""
    return f"XK{index + 1}"


def axis_letters(mask: int) -> str:
    """Return the axes of `mask` in the controller's notation."""
    return "".join(letter for index, letter in enumerate(AXIS_LETTERS) if mask >> index & 1)


def program_lines(axes: int, gate: GateTiming, *, contours: bool = True, probes: bool = True) -> tuple[str, ...]:
    """Return the program's lines for a controller of `axes` axes. contours, probes: whether it has entries for
    them."""
    lines = ["#TUTTI;EN"]
    for mask in range(1 << axes):
        letters = axis_letters(mask)
        begin = (f"BG{letters};" if letters else "") + "XACT=TIME"
        lines += [entry_label(mask, contour=False), *_gate_lines(), f"JP #L{mask},XLI<>0", f"WT XT0-TIME;{begin}"]
        # The watchdog of the step before may still run.
        lines.append(f"#A{mask};HX{WATCHDOG_THREAD};XQ #DOG,{WATCHDOG_THREAD}")
        # On one line, so that the thread behind this one has to wait for one turn only (L14633).
        stamps = [f"AM{letter};XE{AXIS_LETTERS.index(letter) + 1}=TIME" for letter in letters]
        lines += [";".join([*stamps, "XDONE=1"]), "EN", f"#L{mask};AI XLI;{begin};JP #A{mask}"]
    for mask in range(1, 1 << axes):
        lines += following_lines(mask, axes)
        for is_quick in (False, True):
            lines += at_once_lines(mask, axes, quick=is_quick)
    for mask in range(1, 1 << axes) if contours else ():
        lines += contour_lines(mask, axes)
    halts = ";".join(f"HX{thread}" for thread in STEP_THREADS)
    running_sum = "+".join(f"_HX{thread}" for thread in (*STEP_THREADS, EDGE_THREAD))
    lines += [
        *edge_lines(),
        *trigger_lines(),
        *(ring_lines() if contours else ()),
        *(probe_lines(axes) if probes else ()),
        "#GATE;XOK=0;XLATE=0;XACT=0;XDONE=0;XARM=XT0",
        f"#HOLD;WT {STEP_TICKS};JP #HOLD,(XGO=0)&((XT0-TIME)>{gate.decided_before})",
        f"XOK=XGO&((XT0-TIME)>{gate.wait_after_gate})",
        "XLATE=1-XOK;EN",
        "#SHUT;EN",
        *take_lines(range(axes)),
        f"#DOG;WT {WATCHDOG_STEP_TICKS};JP #DOG,(TIME<XDL)&(({running_sum})>0)",
        f"JP #SHUT,XDONE&(_HX{EDGE_THREAD}=0)",
        # The program first, or it would begin the contour again.
        f"{halts};ST{axis_letters((1 << axes) - 1)};XDOG=1",
        f"HX{EDGE_THREAD};JP #LEAVE,XLO=0;{OUTPUT_PASSIVE}",
        "#LEAVE;DT 0;CD 0;EN",
    ]
    return tuple(lines)


def following_lines(mask: int, axes: int) -> list[str]:
    """Return the lines of the axes of `mask` as a step that follows another one. It is the last command before the wait
    that decides, so that a turn that takes too long ends without a start."""
    axis_indices = [index for index in range(axes) if mask >> index & 1]
    letters, everything = axis_letters(mask), axis_letters((1 << axes) - 1)
    registers = ";".join(register_commands(axis_indices))
    off = sum_of_distances(range(axes), AXIS_LETTERS)
    separate = axes > SHORT_CHECK_AXES
    check = "XOFF=0" if separate else f"({off})=0"
    return [
        f"{following_label(mask)};XFARM=XFT",
        f"#G{mask};WT {FOLLOWING_STEP_TICKS};JP #G{mask},(XACT=0)&((XFT-TIME)>{LAST_LOOK_TICKS})",
        f"AM{everything}",
        registers,
        f"#H{mask};JP #R{mask},XFGO=1;WT {FOLLOWING_STEP_TICKS};JP #H{mask},(XFT-TIME)>{LAST_LOOK_TICKS}",
        f"#R{mask}" + (f";XOFF={off}" if separate else ""),
        f"XFOK=XFGO&XDONE&({check})&((XFT-TIME)>{BEGIN_TICKS})",
        f"JP #MISS,XFOK=0;WT XFT-TIME;BG{letters};XFA=TIME",
        f"JS #TAKE;JP #A{mask}",
    ]


def at_once_lines(mask: int, axes: int, *, quick: bool) -> list[str]:
    """Return the lines of the axes of `mask` as a step that begins as soon as the one before has ended as planned.
    quick: speeds and ramps are those of the step before.

    Everything that the end does not change is decided before it. Behind it come the registers, the check, and BG. The
    stamps of the step before are complete by then, because its thread has had its turn (L14633); where that is not so,
    it is given time, once.
    """
    axis_indices = [index for index in range(axes) if mask >> index & 1]
    name = f"{'Q' if quick else 'O'}{mask}"
    everything = axis_letters((1 << axes) - 1)
    registers = register_commands(axis_indices)
    off = sum_of_distances(range(axes), AXIS_LETTERS)
    separate = axes > SHORT_CHECK_AXES
    check = f"XFGO&XDONE&({'XOFF' if separate else f'({off})'}=0)"
    return [
        f"{at_once_label(mask, quick=quick)};XFARM=XFT",
        f"#V{name};WT {FOLLOWING_STEP_TICKS};JP #V{name},(XACT=0)|(XFGO=0)",
        *_join_lines(f"AM{everything}", *(registers[:1] if quick else registers)),
        *([f"XOFF={off}"] if separate else ()),
        f"#B{name};JP #D{name},({check})=0;BG{axis_letters(mask)};XFA=TIME",
        f"JS #TAKE;JP #A{mask}",
        f"#D{name};WT {LAST_LOOK_TICKS};XFL=1-({check})",
        f"JP #B{name},XFL=0;EN",
    ]


def _join_lines(*commands: str) -> list[str]:
    """Return lines of as many of these commands as each can hold."""
    lines = [""]
    for command in commands:
        if lines[-1] and len(lines[-1]) + len(command) < MAX_LINE:
            lines[-1] += f";{command}"
        elif lines[-1]:
            lines.append(command)
        else:
            lines[-1] = command
    return lines


def register_commands(axes: Sequence[int]) -> list[str]:
    """Return the commands that load the registers of axes, by index, from the variables of the following step."""
    return [
        f"{command} " + ",".join(f"{name}{k + 1}" if k in axes else "" for k in range(axes[-1] + 1))
        for command, name in REGISTER_VARIABLES.items()
    ]


def sum_of_distances(axes: Iterable[int], letters: Sequence[str]) -> str:
    """Return the expression of how far axes are, in all, from where the following step begins."""
    return "+".join(f"@ABS[_RP{letters[k]}-{BEGIN_VARIABLE}{k + 1}]" for k in axes)


def take_lines(axes: Iterable[int]) -> list[str]:
    """Return the lines that put the following step in the place of the present one, after its begin. XT0 is last: what
    it stands for is complete whenever it is read. axes: by index."""
    copies = ";".join(["XZA=XACT", *(f"XZ{k + 1}=XE{k + 1}" for k in axes), "XZT=XT0"])
    return [
        f"#TAKE;{copies}",
        "XDONE=0;XACT=XFA;XLI=0;XLATE=0;XARM=XFT;XT0=XFT;EN",
        "#MISS;XFL=1;EN",
    ]


def _gate_lines() -> tuple[str, str]:
    return "JS #GATE", "JP #SHUT,XOK=0"


def contour_lines(mask: int, axes: int, *, ring: bool = True) -> list[str]:
    """Return the lines that play the arrays of the axes of `mask`, of `axes` in all. ring: they can be loaded again
    while they are played.

    Contour mode is left by DT 0 and CD 0 (L4274), which are queued after the last record like a record.
    """
    axis_indices = [index for index in range(axes) if mask >> index & 1]

    def increment_command(element: str) -> str:
        return "CD " + ",".join(
            f"{array_name(k)}[{element}]" if k in axis_indices else "" for k in range(axis_indices[-1] + 1)
        )

    return [
        entry_label(mask, contour=True),
        *_gate_lines(),
        f"CM {axis_letters(mask)};DT XDT;XI=1",
        f"JP #K{mask},XLI<>0",
        f"WT XT0-TIME;{increment_command('0')};XACT=TIME;XQ #DOG,{WATCHDOG_THREAD}",
        f"#P{mask};WC;{increment_command('XI&XW' if ring else 'XI')};XI=XI+1;JP #P{mask},XI<XN",
        "XJ=XTB",
        f"#E{mask};WC;{increment_command('XJ')};XJ=XJ+1;JP #E{mask},XJ<XV",
        f"#T{mask};JP #U{mask},XJ>=XM",
        f"WC;DT {TAIL}[XJ-XV];{increment_command('XJ')};XJ=XJ+1;JP #T{mask}",
        f"#U{mask};WC;DT 0;CD 0",
        f"WC;XE{axis_indices[0] + 1}=TIME;XDONE=1;EN",
        f"#K{mask};AI XLI;{increment_command('0')};XACT=TIME;XQ #DOG,{WATCHDOG_THREAD}",
        f"JP #P{mask}",
    ]


def trigger_lines() -> tuple[str, ...]:
    """Return the lines that switch an output at the samples of a table: by pulses, and by changes of its level.

    They run in the thread of trigger lines, with its variables for the output, so that what halts that thread also
    makes the output passive. The instants come from the plan, and WT waits for them in a move and in a contour alike.
    Of the trip-points on positions MF and MR hold in a contour, too, but they see one direction of one axis, to 2 ms
    (L7476); of AP, AD and AR the manual does not state whether a contour is a profile (L2715-2727).

    An element that was played contains the sample before the command that switched the output: on one line nothing
    comes between the two (L14633). A late instant is played at once: the product is 0 then, and its first factor is
    read first, so that it is never negative, which would end the program (code 6).
    """
    ticks_left = f"(XT0+{TABLE}[XRI]-TIME)"
    wait = f"WT ({ticks_left}>0)*{ticks_left}"
    return (
        f"{PULSE_LABEL};WT {STEP_TICKS};JP #SHUT,XLATE=1;JP {PULSE_LABEL},XOK=0",
        f"#NEXT;{wait};{TABLE}[XRI]=TIME;OB XLO,XLV",
        "WT XLH;OB XLO,1-XLV",
        "XRI=XRI+1;JP #NEXT,XRI<XRN",
        "XLO=0;EN",
        f"{LEVEL_LABEL};WT {STEP_TICKS};JP #SHUT,XLATE=1;JP {LEVEL_LABEL},XOK=0",
        f"#TURN;{wait};{TABLE}[XRI]=TIME;OB XLO,XRV",
        "XRV=1-XRV;XRI=XRI+1;JP #TURN,XRI<XRN",
        "OB XLO,1-XLV;XLO=0;EN",
    )


def ring_lines() -> tuple[str, ...]:
    """Return the lines that play the table as a ring, up to element XRN, which changes while a path is executed.

    A trigger that is far is not waited for by WT, because it may be withdrawn: the program looks again and again
    whether the next one is near. XRN changes only for triggers that are far (`PartRelease`). After each wait come two
    commands at most, or one with an expression, before other threads have their turn (L14633), as with the table.
    """
    ticks_left = f"(XT0+{TABLE}[XRI]-TIME)"
    is_near = f"(XRI<>XRN)&({ticks_left}<XRF)"
    wait = f"WT ({ticks_left}>0)*{ticks_left}"
    return (
        f"{RING_PULSE_LABEL};WT {STEP_TICKS};JP #SHUT,XLATE=1;JP {RING_PULSE_LABEL},XOK=0",
        f"#FAR;WT {FAR_TICKS};JP #NEAR,{is_near}",
        "JP #FAR,XRE=0;OB XLO,1-XLV;XLO=0;EN",
        f"#NEAR;{wait};{TABLE}[XRI]=TIME;OB XLO,XLV",
        "WT XLH;OB XLO,1-XLV;XRI=(XRI+1)&XRM",
        f"JP #NEAR,{is_near}",
        "JP #FAR",
        f"{RING_LEVEL_LABEL};WT {STEP_TICKS};JP #SHUT,XLATE=1;JP {RING_LEVEL_LABEL},XOK=0",
        f"#LFAR;WT {FAR_TICKS};JP #LNEAR,{is_near}",
        "JP #LFAR,XRE=0;OB XLO,1-XLV;XLO=0;EN",
        f"#LNEAR;{wait};{TABLE}[XRI]=TIME;OB XLO,XRV",
        "XRV=1-XRV;XRI=(XRI+1)&XRM",
        f"JP #LNEAR,{is_near}",
        "JP #LFAR",
    )


def probe_lines(axes: int) -> tuple[str, ...]:
    """Return the lines that begin an axis, or the sequence of a line (L13004-13015), and stop it by an input.

    AI tests the level (L2491), so a contact that is made before the axis begins stops it, too. The stop comes first;
    the position behind it is one after the edge, while the axis moves no faster than before.
    """
    letters = AXIS_LETTERS[:axes]
    reads = [f"{probe_position(index)}=_TP{letter}" for index, letter in enumerate(letters)]
    axis_lines = (
        f"{probe_label(index)};BG{letter};AI {PROBE_INPUT};ST{letter};{read_text};{PROBE_TIME}=TIME;EN"
        for index, (letter, read_text) in enumerate(zip(letters, reads, strict=True))
    )
    line = f"{LINE_PROBE_LABEL};BGS;AI {PROBE_INPUT};STS;{';'.join(reads)};{PROBE_TIME}=TIME;EN"
    return (*axis_lines, *([line] if axes > 1 else []))


def edge_lines() -> tuple[str, ...]:
    """Return the lines that drive a trigger line: after the gate has released the step, active at its sample, and
    passive again later. They run in a thread of their own, because BG follows the wait of the step with nothing in
    between."""
    return (
        f"#EDGE;WT {STEP_TICKS};JP #SHUT,XLATE=1;JP #EDGE,XOK=0",
        "WT XT0-TIME;OB XLO,XLV;WT XLH;OB XLO,1-XLV;EN",
    )
