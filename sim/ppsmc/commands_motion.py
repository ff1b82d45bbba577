"""Direct commands that move axes or set their coordinates (section 12.2)."""

import re
from dataclasses import replace
from fractions import Fraction

from sim.ppsmc.axis import StepperAxis
from sim.ppsmc.grammar import (
    InputRefused,
    parse_decimal,
    parse_direction,
    parse_integer,
    require_end,
    split_axis,
    text_after_colon,
)
from sim.ppsmc.homing import homing_steps, read_homing
from sim.ppsmc.legs import Steps, TaskKind
from sim.ppsmc.moves import (
    PositioningStart,
    clock_check,
    full_step,
    jogging_steps,
    oscillation_steps,
    positioning_steps,
    reference_steps,
    single_step,
)
from sim.ppsmc.path import SpeedProfile
from sim.ppsmc.registry import CommandEntry, Commands, CommandUsage
from sim.ppsmc.sensors import TravelSwitch
from sim.ppsmc.unit import CommandClient, ControlProgram

_SPIN_MOST_HZ = 2_457_000
_LATER_PROFILE = re.compile(r"(?:s(\d+))?(?:r(\d+))?(?:a(\d+))?(?:d(\d+))?")


def _parse_addressed(unit: ControlProgram, rest: str) -> tuple[StepperAxis, str]:
    number, rest = split_axis(rest)
    return unit.machine.find_axis(number), rest


def _require_idle(axis: StepperAxis) -> None:
    if axis.task is not None:
        raise InputRefused(f"axis {axis.number} is busy")


def _launch_task(unit: ControlProgram, client: CommandClient, axis: StepperAxis, kind: TaskKind, steps: Steps) -> None:
    unit.send_messages_to(axis, client)
    unit.machine.launch_task(axis, kind, steps)


# Positioning


def _parse_distance(unit: ControlProgram, axis: StepperAxis, text: str) -> tuple[Fraction, SpeedProfile | None]:
    """Parse a distance; later firmware accepts a profile for this one move after `*`."""
    if not unit.is_modern or "*" not in text:
        return parse_decimal(text), None
    text, _, suffix = text.partition("*")
    match = _LATER_PROFILE.fullmatch(suffix.lower())
    if match is None:
        raise InputRefused("not a profile")
    start, slew, up, down = (None if part is None else float(part) for part in match.groups())
    profile = axis.settings.speed_profile
    up = profile.acceleration / 1000.0 if up is None else up
    down = up if down is None else down
    if min(up, down, 1.0 if start is None else start, 1.0 if slew is None else slew) < 1.0:
        raise InputRefused("profile out of range")
    return parse_decimal(text), SpeedProfile(start or profile.start, slew or profile.slew, up * 1000.0, down * 1000.0)


def _start_positioning(
    unit: ControlProgram, client: CommandClient, rest: str, *, absolute: bool, counting: bool = False
) -> None:
    """goto, move and movec; for a moving axis the target waits, one at most (decision 13)."""
    axis, rest = _parse_addressed(unit, rest)
    if counting and unit.counter.is_counting:
        raise InputRefused("the counter is busy")
    distance, own = _parse_distance(unit, axis, text_after_colon(rest))
    steps = axis.count_steps(distance)
    machine = unit.machine

    def finish_count() -> None:
        client.send_reply(str(unit.counter.stop_count()))

    def begin_positioning() -> None:
        target = steps if absolute else axis.steps + steps
        machine.check_target(target)
        unit.send_messages_to(axis, client)
        task = positioning_steps(machine, axis, target, PositioningStart(own or axis.settings.speed_profile))
        if counting:
            machine.check_input(axis)
            unit.counter.begin_count()
        machine.launch_task(axis, TaskKind.POSITIONING, task, finish_count if counting else None)

    def begin_after_motion() -> None:
        try:
            begin_positioning()
        except InputRefused as refusal:
            if unit.echo:
                client.send_reply(f"error: {refusal}")

    if axis.task is None:
        begin_positioning()
    elif axis.task.kind is TaskKind.POSITIONING and axis.queued is None and unit.options.queue_target:
        axis.queued = begin_after_motion
    else:
        raise InputRefused(f"axis {axis.number} is busy")


def _execute_goto(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    _start_positioning(unit, client, rest, absolute=True)


def _execute_move(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    _start_positioning(unit, client, rest, absolute=False)


def _execute_movec(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    _start_positioning(unit, client, rest, absolute=False, counting=True)


# Continuous motion


def _execute_fast(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    axis, rest = _parse_addressed(unit, rest)
    _launch_task(unit, client, axis, TaskKind.JOG, jogging_steps(parse_direction(rest), axis.settings.speed_profile))


def _execute_run(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    axis, rest = _parse_addressed(unit, rest)
    profile = axis.settings.speed_profile
    _launch_task(
        unit, client, axis, TaskKind.JOG, jogging_steps(parse_direction(rest), replace(profile, slew=profile.start))
    )


def _execute_step(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    axis, rest = _parse_addressed(unit, rest)
    _launch_task(unit, client, axis, TaskKind.JOG, single_step(axis, parse_direction(rest)))


def _execute_spin(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """spin: accepted also while the same axis spins (L2854)."""
    axis, rest = _parse_addressed(unit, rest)
    text = text_after_colon(rest)
    sign = parse_direction(text[:1])
    profile = axis.settings.speed_profile
    if text[1:]:
        profile = replace(profile, slew=float(parse_integer(text[1:], 1, _SPIN_MOST_HZ)))
    if axis.task is not None and axis.task.kind is TaskKind.SPIN and axis.run is not None and not axis.run.stopping:
        unit.machine.check_input(axis)
        unit.machine.drive.change_speed(axis.run, sign, profile)
    elif unit.is_idle:
        _launch_task(unit, client, axis, TaskKind.SPIN, jogging_steps(sign, profile))
    else:
        raise InputRefused("not allowed during positioning")


def _execute_osc(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    axis, rest = _parse_addressed(unit, rest)
    amplitude = axis.count_steps(parse_decimal(text_after_colon(rest)))
    if not amplitude:
        if axis.task is not None and axis.task.kind is TaskKind.OSCILLATION:
            unit.machine.stop_axis(axis)
        return
    _require_idle(axis)
    for side in (1, -1):
        unit.machine.check_target(axis.steps + side * amplitude)
    _launch_task(unit, client, axis, TaskKind.OSCILLATION, oscillation_steps(unit.machine, axis, amplitude))


def _execute_quit(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    number, rest = split_axis(rest)
    require_end(rest)
    if number is None or number == 0:
        unit.stop_all()
    else:
        unit.machine.stop_axis(unit.machine.find_axis(number))


# Homing and coordinates


def _execute_home(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    axis, rest = _parse_addressed(unit, rest)
    _require_idle(axis)
    if rest and not rest.startswith(":"):
        raise InputRefused(f"'{rest}' not expected")
    homing = read_homing(rest[1:])
    steps = homing_steps(axis, homing)
    if homing.has_motion:
        unit.machine.check_input(axis)
    _launch_task(unit, client, axis, TaskKind.HOMING, steps)


def _search_switch(
    unit: ControlProgram, client: CommandClient, rest: str, switch: TravelSwitch, *, directed: bool
) -> None:
    axis, rest = _parse_addressed(unit, rest)
    if not directed:
        require_end(rest)
    rest = rest.removeprefix(":")
    sign = parse_direction(rest) if rest else -1
    if switch is TravelSwitch.INDEX or not axis.referenced:
        _launch_task(unit, client, axis, TaskKind.HOMING, reference_steps(axis, sign, switch))


def _execute_ref(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    if not rest:
        for axis in unit.machine.axes:
            _search_switch(unit, client, axis.name, TravelSwitch.ORG, directed=False)
    else:
        _search_switch(unit, client, rest, TravelSwitch.ORG, directed=False)


def _execute_org(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    _search_switch(unit, client, rest, TravelSwitch.ORG, directed=True)


def _execute_eref(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    axis, _ = _parse_addressed(unit, rest)
    if axis.encoder is None:
        raise InputRefused(f"axis {axis.number} has no encoder")
    _search_switch(unit, client, rest, TravelSwitch.INDEX, directed=True)


def _execute_pos(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    axis, rest = _parse_addressed(unit, rest)
    steps = axis.count_steps(parse_decimal(text_after_colon(rest)))
    unit.machine.check_target(steps)
    axis.set_counter(steps)


def _execute_zero(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    number, rest = split_axis(rest)
    require_end(rest)
    for axis in unit.machine.select_axes(number or None):
        axis.set_counter(axis.count_steps(axis.settings.rofs))


def _execute_sync(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """`p` (or nothing): position := encoder; `e`: encoder := position (L2942-L2950)."""
    del client
    number, rest = split_axis(rest)
    mode = text_after_colon(rest).lower() if rest else "p"
    if mode not in ("p", "e"):
        raise InputRefused("mode is 'p' or 'e'")
    machine = unit.machine
    for axis in machine.select_axes(number or None):
        if axis.encoder is None:
            continue
        if mode == "e":
            axis.load_encoder(axis.steps_to_distance(axis.steps))
        else:
            axis.set_counter(axis.count_steps(machine.measured_position(axis)))


def _execute_lpox(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    require_end(rest)
    for axis, steps in zip(unit.machine.axes, unit.disk.positions or (), strict=False):
        axis.set_counter(steps)


# Target buffer


def _execute_tbc(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    require_end(rest)
    for axis in unit.machine.axes:
        axis.target = None


def _execute_tbs(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    axis, rest = _parse_addressed(unit, rest)
    text = text_after_colon(rest)
    absolute = text[:1].lower() == "a"
    distance = parse_decimal(text[1:] if text[:1].lower() in ("a", "r") else text)
    unit.machine.check_target(axis.count_steps(distance))
    axis.target = (absolute, distance) if absolute or distance else None


def _execute_tbg(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """Start all axes with a target together; a limit switch that is active stops the group, without iel (L2994)."""
    ignore = rest.lower() == ":iel"
    if rest and not ignore:
        raise InputRefused(f"'{rest}' not expected")
    machine = unit.machine
    if not ignore and machine.is_any_limit_on:
        raise InputRefused("limit switch active")
    targets: list[tuple[StepperAxis, int]] = []
    for axis in machine.axes:
        if axis.target is not None:
            absolute, distance = axis.target
            target = axis.count_steps(distance) + (0 if absolute else axis.steps)
            machine.check_target(target)
            targets.append((axis, target))
    refusals: list[str] = []
    for axis, target in targets:
        start_ns = machine.group_start_ns() if len(targets) > 1 else None
        steps = positioning_steps(machine, axis, target, PositioningStart(axis.settings.speed_profile, start_ns))
        try:
            _launch_task(unit, client, axis, TaskKind.POSITIONING, steps)
        except InputRefused as refusal:
            refusals.append(str(refusal))
    if not unit.options.keep_target_buffer:
        _execute_tbc(unit, client, "")
    if refusals:
        raise InputRefused(", ".join(refusals))


# Special


def _execute_ffst(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    axis, rest = _parse_addressed(unit, rest)
    if axis.number > 8:
        raise InputRefused("axes 1 to 8 only")
    _launch_task(
        unit, client, axis, TaskKind.JOG, full_step(unit.machine, axis, parse_direction(text_after_colon(rest)))
    )


def _execute_sysclk(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    require_end(rest)
    axis = unit.machine.find_axis(1)
    if any(unit.machine.is_limit_on(axis, switch) for switch in (TravelSwitch.EL_MINUS, TravelSwitch.EL_PLUS)):
        raise InputRefused("limit switch of axis 1 active")
    _launch_task(unit, client, axis, TaskKind.POSITIONING, clock_check(axis))


MOTION: Commands = {
    "eref": CommandEntry(_execute_eref, CommandUsage.IDLE, "search encoder reference"),
    "fast": CommandEntry(_execute_fast, CommandUsage.IDLE, "move continuously at slew speed"),
    "ffst": CommandEntry(_execute_ffst, CommandUsage.IDLE, "find next full-step motor position", needs="full_step"),
    "goto": CommandEntry(_execute_goto, CommandUsage.NOT_PROGRAM, "move axis to absolute position"),
    "home": CommandEntry(_execute_home, CommandUsage.NOT_PROGRAM, "execute homing procedure"),
    "lpox": CommandEntry(_execute_lpox, CommandUsage.IDLE, "load position values"),
    "move": CommandEntry(_execute_move, CommandUsage.NOT_PROGRAM, "execute relative movement"),
    "movec": CommandEntry(
        _execute_movec, CommandUsage.NOT_PROGRAM, "execute relative movement and count", needs="counter"
    ),
    "org": CommandEntry(_execute_org, CommandUsage.IDLE, "search reference position"),
    "osc": CommandEntry(_execute_osc, CommandUsage.ALWAYS, "start oscillation"),
    "pos": CommandEntry(_execute_pos, CommandUsage.IDLE, "set position display"),
    "q": CommandEntry(_execute_quit, CommandUsage.ALWAYS, "cancel positioning task", names=("quit", "stop")),
    "ref": CommandEntry(_execute_ref, CommandUsage.IDLE, "search reference position"),
    "run": CommandEntry(_execute_run, CommandUsage.IDLE, "move continuously at start-stop speed"),
    "spin": CommandEntry(_execute_spin, CommandUsage.ALWAYS, "start continuous motion"),
    "step": CommandEntry(_execute_step, CommandUsage.IDLE, "execute single motor step"),
    "sync": CommandEntry(_execute_sync, CommandUsage.IDLE, "synchronize position"),
    "sysclk": CommandEntry(_execute_sysclk, CommandUsage.IDLE, "check system clock setting"),
    "tbc": CommandEntry(_execute_tbc, CommandUsage.IDLE, "clear target buffer"),
    "tbg": CommandEntry(_execute_tbg, CommandUsage.IDLE, "start positioning task according to the target buffer"),
    "tbs": CommandEntry(_execute_tbs, CommandUsage.IDLE, "set target buffer"),
    "zero": CommandEntry(_execute_zero, CommandUsage.IDLE, "set position display to zero"),
}
"""Motion commands by name."""
