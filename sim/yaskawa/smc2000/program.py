"""Programs, arrays, lists and reset of the SMC-2000: LA LL QU TB RS (L9826, L10003, L10807, L10969)."""

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.commands.data import array_name, listing, span
from sim.yaskawa.commands.status import general, report, tell_code
from sim.yaskawa.commands.system import mark_messages
from sim.yaskawa.language.arguments import parse_fields, split, values
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import integer
from sim.yaskawa.language.registry import SMC2000_COMMANDS, Outcome, Runner, bare, command
from sim.yaskawa.language.statements import Raw
from sim.yaskawa.ports.ports import END_OF_TEXT

RESET, PARAMETERS, CLEAR = 0, 1, 2


def _arrays(c: Context) -> list[str]:
    arrays = c.machine.data.arrays
    return [f"{name}[{len(arrays[name])}]" for name in sorted(arrays)]


listing("LA", _arrays, SMC2000_COMMANDS)
listing("LL", lambda c: [f"#{label}" for label in sorted(c.machine.program.labels)], SMC2000_COMMANDS)


@command("QU", table=SMC2000_COMMANDS)
def _upload_array(text: str) -> Runner:
    """Elements in the variable format, separated and not ended by comma or carriage return, then ctrl-Z (D37)."""
    name_text, *rest = split(text)
    name = array_name(name_text)
    fields = values(parse_fields(",".join(rest), 3))

    def run(c: Context) -> Outcome:
        array = c.machine.data.array(name)
        given = [*fields(c), None, None]
        first, last = span(c, len(array), given)
        separator = "," if given[2] is not None and fixed.truncated(given[2]) == 1 else "\r"
        written = separator.join(c.machine.show_value(raw) for raw in array[first : last + 1]) + END_OF_TEXT
        if c.port is None:
            c.machine.ports.message(written)
            return None
        return Raw(written)

    return run


@command("CW", table=SMC2000_COMMANDS)
def _mark_messages(text: str) -> Runner:
    """`CW ?` tells the copyright, too (L8074)."""
    return mark_messages("0" if text == "?" else text)


@command("TC", table=SMC2000_COMMANDS)
def _tell_code(text: str) -> Runner:
    """`TC1{N}` leaves the end of the line to the next message, as the manual's programs have it (L13229)."""
    told = tell_code(text.removesuffix("{N}"))
    if not text.endswith("{N}"):
        return told

    def run(c: Context) -> Outcome:
        written = told(Context(c.machine, None, c.port))
        if not isinstance(written, str):
            return None
        if c.thread is None:
            return Raw(written)
        c.machine.ports.message(written)
        return None

    return run


@command("TB", table=SMC2000_COMMANDS)
def _tell_status(text: str) -> Runner:
    """Printed as short as it is (L11675)."""
    bare(text.removeprefix("?"))
    return lambda c: report(c, c.machine.show_whole(general(c), len(str(general(c)))))


@command("RS", where="line", table=SMC2000_COMMANDS)
def _reset(text: str) -> Runner:
    """`RS` resets, `RS1` restores what BN has kept, `RS2` clears the program (L11364)."""
    value = integer(text) if text else None

    def run(c: Context) -> Outcome:
        what = value(c) if value is not None else RESET
        if what not in (RESET, PARAMETERS, CLEAR):
            raise CommandError(6)
        if what == RESET:
            c.machine.reset()
        elif what == PARAMETERS:
            c.machine.memory.restore_parameters()
        else:
            c.machine.interpreter.halt_all()
            c.machine.program.clear()
        return None

    return run
