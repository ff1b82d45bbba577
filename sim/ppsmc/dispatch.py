"""From a received line to what it does; every kind of bad input ends here."""

from sim.ppsmc.commands_motion import MOTION
from sim.ppsmc.commands_setup import SETUP
from sim.ppsmc.commands_system import SYSTEM
from sim.ppsmc.grammar import Refused, split_name
from sim.ppsmc.program import NAMES as PROGRAM_NAMES
from sim.ppsmc.program import NEEDS as PROGRAM_NEEDS
from sim.ppsmc.queries import QUERIES
from sim.ppsmc.registry import Command, Commands, When, by_all_names
from sim.ppsmc.unit import Client, Unit


def _information(unit: Unit, client: Client, rest: str) -> None:
    """`?`, `?:cmdlist` and `?:<command>` (L3851-L3883)."""
    if rest:
        known = _known(unit)
        if not rest.startswith(":"):
            raise Refused(f"unknown command '?{rest}'")
        asked = rest[1:].strip().lower()
        if asked == "cmdlist":
            for name in sorted({*known, *PROGRAM_NAMES}):
                client.say(name)
        elif asked in known:
            client.say(f"{asked}: {known[asked].help}")
        elif asked in PROGRAM_NAMES:
            client.say(f"{asked}: program command")
        else:
            raise Refused(f"no command '{asked}'")
        return
    for line in (
        unit.version,
        f"number of axes: {len(unit.machine.axes)}",
        f"options: {', '.join(unit.options.hardware) or 'none'}",
        f"ip address: {unit.disk.address}",
        f"system date: {unit.calendar:%B %d, %Y %H:%M:%S}",
        "?:cmdlist - command list",
        "?:<cmd> - brief explanation of command",
        "?conf - configuration settings",
    ):
        client.say(line)


COMMANDS: Commands = by_all_names(
    MOTION, SETUP, SYSTEM, QUERIES, {"?": Command(_information, When.IDLE, "get general information")}
)
"""All commands but the program's, by all their names."""

_MANUAL: Commands = {name: command for name, command in COMMANDS.items() if not command.later}


def _known(unit: Unit) -> Commands:
    """The commands that the unit's firmware knows."""
    return COMMANDS if unit.modern else _MANUAL


def execute(unit: Unit, client: Client, line: str, whole: bool = True) -> None:
    """Carry out one command line. What is wrong with it is said with echo 1 and 2 only (decisions 4 and 5)."""
    line = line.strip()
    if not line or line.startswith("#"):
        return
    try:
        if not whole:
            raise Refused("line too long")
        _execute(unit, client, line)
    except Refused as why:
        if unit.echo and not unit.blocked:
            client.say(f"error: {why}")


def _execute(unit: Unit, client: Client, line: str) -> None:
    name, rest = split_name(line)
    if line.lower() == "*idn?":
        name, rest = "*idn?", ""
    if name.rstrip(";") in PROGRAM_NAMES or line[0].isdigit():
        _store(unit, name.rstrip(";"), line)
        return
    command = _known(unit).get(name)
    if command is None:
        raise Refused(f"unknown command '{line}'")
    if unit.blocked and not command.blocked:
        raise Refused("controller blocked")
    if command.needs is not None and not unit.machine.has(command.needs):
        raise Refused(f"'{name}' needs an option that is not installed")
    if command.when is When.IDLE and not unit.idle:
        raise Refused(f"'{name}' not allowed during positioning")
    if command.when is When.NOT_PROGRAM and unit.runner.running:
        raise Refused(f"'{name}' not allowed during program execution")
    command.run(unit, client, rest)


def _store(unit: Unit, name: str, line: str) -> None:
    """A program command: into the memory of an idle unit."""
    if unit.blocked:
        raise Refused("controller blocked")
    needs = PROGRAM_NEEDS.get(PROGRAM_NAMES.get(name, ""))
    if needs is not None and not unit.machine.has(needs):
        raise Refused(f"'{name}' needs an option that is not installed")
    if not unit.idle:
        raise Refused("not allowed during positioning")
    unit.memory.add(line)
