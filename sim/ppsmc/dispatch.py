"""Dispatch of a received line to its command; all invalid input is handled here."""

from sim.ppsmc.commands_motion import MOTION
from sim.ppsmc.commands_setup import SETUP
from sim.ppsmc.commands_system import SYSTEM
from sim.ppsmc.grammar import InputRefused, split_name
from sim.ppsmc.program import NAMES as PROGRAM_NAMES
from sim.ppsmc.program import NEEDS as PROGRAM_NEEDS
from sim.ppsmc.queries import QUERIES
from sim.ppsmc.registry import CommandEntry, Commands, CommandUsage, by_all_names
from sim.ppsmc.unit import CommandClient, ControlProgram


def _execute_information(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """`?`, `?:cmdlist` and `?:<command>` (L3851-L3883)."""
    if rest:
        commands = _known_commands(unit)
        if not rest.startswith(":"):
            raise InputRefused(f"unknown command '?{rest}'")
        command = rest[1:].strip().lower()
        if command == "cmdlist":
            for name in sorted({*commands, *PROGRAM_NAMES}):
                client.send_reply(name)
        elif command in commands:
            client.send_reply(f"{command}: {commands[command].help}")
        elif command in PROGRAM_NAMES:
            client.send_reply(f"{command}: program command")
        else:
            raise InputRefused(f"no command '{command}'")
        return
    for line in (
        unit.firmware_version,
        f"number of axes: {len(unit.machine.axes)}",
        f"options: {', '.join(unit.options.hardware) or 'none'}",
        f"ip address: {unit.disk.address}",
        f"system date: {unit.system_clock:%B %d, %Y %H:%M:%S}",
        "?:cmdlist - command list",
        "?:<cmd> - brief explanation of command",
        "?conf - configuration settings",
    ):
        client.send_reply(line)


COMMANDS: Commands = by_all_names(
    MOTION,
    SETUP,
    SYSTEM,
    QUERIES,
    {"?": CommandEntry(_execute_information, CommandUsage.IDLE, "get general information")},
)
"""All commands but the program's, by all their names."""

_MANUAL: Commands = {name: command for name, command in COMMANDS.items() if not command.later}


def _known_commands(unit: ControlProgram) -> Commands:
    """Return the commands that the firmware supports."""
    return COMMANDS if unit.is_modern else _MANUAL


def execute_line(unit: ControlProgram, client: CommandClient, line: str, *, whole: bool = True) -> None:
    """Execute one command line. Errors are reported with echo 1 and 2 only (decisions 4 and 5)."""
    line = line.strip()
    if not line or line.startswith("#"):
        return
    try:
        if not whole:
            raise InputRefused("line too long")
        _execute_command(unit, client, line)
    except InputRefused as refusal:
        if unit.echo and not unit.blocked:
            client.send_reply(f"error: {refusal}")


def _execute_command(unit: ControlProgram, client: CommandClient, line: str) -> None:
    name, arguments = split_name(line)
    if line.lower() == "*idn?":
        name, arguments = "*idn?", ""
    if name.rstrip(";") in PROGRAM_NAMES or line[0].isdigit():
        _store_command(unit, name.rstrip(";"), line)
        return
    command = _known_commands(unit).get(name)
    if command is None:
        raise InputRefused(f"unknown command '{line}'")
    if unit.blocked and not command.blocked:
        raise InputRefused("controller blocked")
    if command.needs is not None and not unit.machine.has_hardware(command.needs):
        raise InputRefused(f"'{name}' needs an option that is not installed")
    if command.when is CommandUsage.IDLE and not unit.is_idle:
        raise InputRefused(f"'{name}' not allowed during positioning")
    if command.when is CommandUsage.NOT_PROGRAM and unit.runner.is_running:
        raise InputRefused(f"'{name}' not allowed during program execution")
    command.run(unit, client, arguments)


def _store_command(unit: ControlProgram, name: str, line: str) -> None:
    """Store a program command in the memory of an idle controller."""
    if unit.blocked:
        raise InputRefused("controller blocked")
    needs = PROGRAM_NEEDS.get(PROGRAM_NAMES.get(name, ""))
    if needs is not None and not unit.machine.has_hardware(needs):
        raise InputRefused(f"'{name}' needs an option that is not installed")
    if not unit.is_idle:
        raise InputRefused("not allowed during positioning")
    unit.memory.add_command(line)
