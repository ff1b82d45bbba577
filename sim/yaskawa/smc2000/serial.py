"""Port 2, communication interrupts and operator input of the SMC-2000: CC CI EN IN (L917-L995, L4740-L4875)."""

import re

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.flow import running_thread
from sim.yaskawa.language.arguments import compile_values, parse_fields, split_fields
from sim.yaskawa.language.context import CommandContext
from sim.yaskawa.language.registry import SMC2000_COMMANDS, Outcome, Runner, register_command
from sim.yaskawa.motion.trippoints import when_passed

BAUD_RATES = (300, 1200, 4800, 9600, 19200, 38400)
LONGEST_PROMPT = 60
_VARIABLE = re.compile(r"([A-Za-z][A-Za-z0-9]*)(?:\{S([1-6]?)\})?")


@register_command("CC", table=SMC2000_COMMANDS)
def _compile_configure_port(text: str) -> Runner:
    """Baud rate, handshake, general port or daisy chain, echo; takes effect after the answer (D45)."""
    fields = compile_values(parse_fields(text, 4))

    def run_command(c: CommandContext) -> Outcome:
        machine = c.machine
        values = [None if raw is None else fixed.to_integer(raw) for raw in [*fields(c), None, None, None]]
        baud, handshake, chain_mode, echo = (
            old if new is None else new for old, new in zip(machine.second_line, values, strict=False)
        )
        if baud not in BAUD_RATES or {handshake, chain_mode, echo} - {0, 1}:
            raise CommandError(6)
        machine.second_line = (baud, handshake, chain_mode, echo)
        machine.operator_input.entries["2"].set_enabled(on=not chain_mode)
        return None

    return run_command


@register_command("CI", where="program", table=SMC2000_COMMANDS)
def _compile_communication_interrupt(text: str) -> Runner:
    """Set the event on each port that calls #COMINT, and whether port 1 accepts operator data in place of commands
    (L7824)."""
    fields = compile_values(parse_fields(text, 3))

    def run_command(c: CommandContext) -> Outcome:
        machine = c.machine
        values = [None if raw is None else fixed.to_integer(raw) for raw in [*fields(c), None, None]]
        modes, data = dict(zip(("S", "2"), values, strict=False)), values[2]
        if any(mode not in (None, -1, 0, 1, 2) for mode in modes.values()) or data not in (None, 0, 1):
            raise CommandError(6)
        for port, mode in modes.items():
            if mode == -1:
                machine.operator_input.entries[port].clear_input()
            elif mode is not None:
                machine.interrupting[port] = mode
        machine.interrupting_on = any(machine.interrupting.values())
        if data is not None:
            machine.operator_input.entries["S"].set_enabled(on=data == 1)
        return None

    return run_command


@register_command("EN", where="program", table=SMC2000_COMMANDS)
def _compile_end(text: str) -> Runner:
    """`EN m,n`: m restores the interrupted trip-point, n allows the next #COMINT (L8525)."""
    fields = compile_values(parse_fields(text, 2)) if text else None

    def run_command(c: CommandContext) -> Outcome:
        restore, repeat = [fixed.to_integer(raw or 0) for raw in [*(fields(c) if fields else []), 0, 0]][:2]
        if restore not in (0, 1) or repeat not in (0, 1):
            raise CommandError(6)
        thread = running_thread(c)
        if not thread.stack:
            thread.halt_thread()
        elif thread.leave_subroutine(restore=restore == 1) == "COMINT" and repeat:
            c.machine.interrupting_on = True
        return None

    return run_command


@register_command("IN", where="program", table=SMC2000_COMMANDS)
def _compile_input(text: str) -> Runner:
    """`IN {P2}"prompt",NAME{Sn}`: thread 0 waits for a value (L9347)."""
    port = "2" if text.startswith("{P2}") else "S"
    parts = split_fields(text[4:] if text.startswith(("{P1}", "{P2}")) else text)
    if len(parts) < 2:
        raise CommandError(65)
    prompt, variable = parts[0].strip('"'), _VARIABLE.fullmatch(parts[1])
    if not parts[1]:
        raise CommandError(25)
    if variable is None or len(parts) > 2:
        raise CommandError(9)
    if len(prompt) > LONGEST_PROMPT:
        raise CommandError(52)
    name, size = variable[1], variable[2]
    length = 0 if size is None else int(size or fixed.STRING_LENGTH)

    def run_command(c: CommandContext) -> Outcome:
        thread = running_thread(c)
        if thread.number:
            raise CommandError(71)
        thread.input_for, thread.input_port, thread.input_length = name, port, length
        c.machine.ports.send_text(port, prompt)
        return when_passed(lambda machine, sample: not thread.input_for)

    return run_command
