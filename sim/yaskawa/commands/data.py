"""Formats, messages, arrays, listings, download and upload (L3971-L4226, L6698-L7564, L8267-L9394, L11125-L11391)."""

import re
from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.formats import Format, Layout
from sim.yaskawa.language.arguments import parse_fields, split, values
from sim.yaskawa.language.context import Context
from sim.yaskawa.language.expressions import Evaluator, compile_expression, integer
from sim.yaskawa.language.registry import COMMANDS, Command, Outcome, Runner, bare, command
from sim.yaskawa.language.statements import Raw, local_format
from sim.yaskawa.ports.ports import END_OF_TEXT

_BRACES = re.compile(r"\{[^{}]*\}")


@command("PF")
def _position_format(text: str) -> Runner:
    """One format for all axes; of several, as in L16428 (SMC-2000: L1502), the first counts."""
    if text == "?":
        return lambda c: c.machine.show("PF", c.machine.position_format.value)
    value = compile_expression(split(text)[0])

    def run(c: Context) -> Outcome:
        c.machine.position_format = Format.of(value(c))
        return None

    return run


@command("VF")
def _variable_format(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.show("VF", c.machine.variable_format.value)
    value = compile_expression(text)

    def run(c: Context) -> Outcome:
        c.machine.variable_format = Format.of(value(c))
        return None

    return run


@command("LZ")
def _leading_zeros(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.show_value(fixed.whole(int(c.machine.layout.strip_zeros)))
    value = integer(text)

    def run(c: Context) -> Outcome:
        number = value(c)
        if number not in (0, 1):
            raise CommandError(6)
        c.machine.layout = Layout(number == 1, c.machine.layout.sign_column)
        return None

    return run


# Messages

Part = Callable[[Context], str]


@command("MG")
def _message(text: str) -> Runner:
    target = ""
    if text.startswith("{E"):
        target, text = text[2:3], text[4:].lstrip(",")
        if not "A" <= target <= "H":
            raise CommandError(53)
    elif text.startswith("{P"):
        target, text = "2" if text[2:3] == "2" else "S", text[4:].lstrip(",")
    line_end = True
    parts: list[Part] = []
    for piece in split(text):
        for part in _pieces(piece):
            if part in ("{N}", "{n}"):
                line_end = False
            else:
                parts.append(_part(part))

    def run(c: Context) -> Outcome:
        written = "".join(part(c) for part in parts)
        if target:
            if not c.machine.ports.opened(target):
                raise CommandError(126)
            c.machine.ports.tell(target, f"{written}\r\n" if line_end else written)
        elif c.thread is not None:
            c.machine.ports.message(f"{written}\r\n" if line_end else written)
        else:
            return written if line_end else Raw(written)
        return None

    return run


def _pieces(piece: str) -> list[str]:
    """A field of MG, taken apart where braces stand alone behind it (`{^07}{^255}`, `V{F4.2}{N}`)."""
    found: list[str] = []
    rest = piece
    while rest:
        if rest.startswith("{"):
            end = rest.find("}")
            if end < 0:
                raise CommandError(53)
            found.append(rest[: end + 1])
            rest = rest[end + 1 :]
            continue
        if rest.startswith('"'):
            end = rest.find('"', 1)
            if end < 0:
                raise CommandError(52)
            found.append(rest[: end + 1])
            rest = rest[end + 1 :]
            continue
        end = rest.find("{")
        value = rest if end < 0 else rest[:end]
        rest = "" if end < 0 else rest[end:]
        match = _BRACES.match(rest)
        if match is not None and match[0][1:2] in ("F", "$", "S"):
            value += match[0]
            rest = rest[match.end() :]
        found.append(value)
    return found


def _part(text: str) -> Part:
    if text.startswith('"'):
        return lambda c: text[1:-1]
    if text.startswith("{^"):
        number = text[2:-1]
        if not number.isdigit() or int(number) > 255:
            raise CommandError(53)
        return lambda c: chr(int(number))
    if text.startswith("{"):
        raise CommandError(53)
    body, _, form = text.partition("{")
    value = compile_expression(body.removesuffix("="))
    if form:
        write = local_format("{" + form)
        return lambda c: write(c, value(c))
    return lambda c: c.machine.show_value(value(c))


# Arrays

_FREED = re.compile(r"(\*|[A-Za-z][A-Za-z0-9]*|\*\*)(\[0\])?")
_DIMENSION = re.compile(r"([A-Za-z][A-Za-z0-9]*)\[(.+)\]")


@command("DM")
def _dimension(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.show_value(fixed.whole(c.machine.data.free_elements()))
    wanted: list[tuple[str, Callable[[Context], int]]] = []
    for part in split(text):
        match = _DIMENSION.fullmatch(part)
        if match is None:
            raise CommandError(55 if part else 50)
        wanted.append((match[1], integer(match[2])))

    def run(c: Context) -> Outcome:
        for name, size in wanted:
            c.machine.data.dimension(name, size(c), c.machine.model.proper_arrays)
        return None

    return run


@command("DA")
def _deallocate(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.show_value(fixed.whole(30 - len(c.machine.data.arrays)))
    names = split(text)
    if any(_FREED.fullmatch(name) is None for name in names):
        raise CommandError(4 if text else 50)

    def run(c: Context) -> Outcome:
        for name in names:
            c.machine.data.free(name)
        return None

    return run


def array_name(text: str) -> str:
    """The name in `NAME[]`."""
    if not text.endswith("[]"):
        raise CommandError(55)
    return text[:-2]


def span(c: Context, size: int, given: list[int | None]) -> tuple[int, int]:
    """First and last element of a transfer."""
    first = 0 if given[0] is None else fixed.truncated(given[0])
    last = size - 1 if given[1] is None else fixed.truncated(given[1])
    if not 0 <= first <= last < size:
        raise CommandError(56)
    return first, last


@command("QD")
def _download_array(text: str) -> Runner:
    name_text, *rest = split(text)
    name = array_name(name_text)
    fields = values(parse_fields(",".join(rest), 2))

    def run(c: Context) -> Outcome:
        port = c.port or (None if c.machine.model.still_data else c.machine.ports.serial)
        if port is None:
            raise CommandError(3)
        if c.machine.model.still_data and c.machine.motion.active():
            raise CommandError(7)
        array = c.machine.data.array(name)
        first, last = span(c, len(array), [*fields(c), None])

        def finish(loaded: str) -> None:
            parts = [part for part in re.split(r"[,\r\n]+", loaded) if part.strip()]
            numbers: list[int] = []
            for part in parts:
                try:
                    numbers.append(compile_expression(part.replace(" ", ""))(c))
                except CommandError:
                    raise CommandError(83) from None
            if len(numbers) > last - first + 1:
                raise CommandError(84)
            array[first : first + len(numbers)] = numbers

        port.download = finish
        return None

    return run


@command("QU")
def _upload_array(text: str) -> Runner:
    name_text, *rest = split(text)
    name = array_name(name_text)
    fields = values(parse_fields(",".join(rest), 3))

    def run(c: Context) -> Outcome:
        if c.machine.motion.active():
            raise CommandError(7)
        array = c.machine.data.array(name)
        given = [*fields(c), None, None]
        first, last = span(c, len(array), given)
        comma = given[2] is not None and fixed.truncated(given[2]) == 1
        numbers = [c.machine.position_format.write(raw, c.machine.layout) for raw in array[first : last + 1]]
        written = (",".join(numbers) if comma else "\r".join(numbers)) + ("" if comma else "\r") + END_OF_TEXT
        if c.port is None:
            c.machine.ports.message(written)
            return None
        return written

    return run


@command("RA")
def _record_arrays(text: str) -> Runner:
    names = [array_name(part) for part in split(text)]

    def run(c: Context) -> Outcome:
        if len(names) > c.machine.options.channels:
            raise CommandError(4)
        for name in names:
            c.machine.data.array(name)
        c.machine.recorder.arrays = list(names)
        return None

    return run


def _digital(volts: Evaluator) -> Evaluator:
    """Torque is recorded as what the converter gets (L16029; SMC-2000: L4621)."""
    return lambda c: fixed.whole(round(volts(c) / fixed.ONE * _DIGITAL_TORQUE / _FULL_VOLTS))


_DIGITAL_TORQUE = 32703
_FULL_VOLTS = 9.9988
_RECORDED = ("DE", "TP", "TE", "SH", "RP", "RL", "TI", "OP", "TS", "SC", "TB", "TT")


@command("RD")
def _record_data(text: str) -> Runner:
    sources: list[Evaluator] = []
    for part in split(text):
        if not part.startswith("_") or part[1:3] not in _RECORDED:
            raise CommandError(58)
        source = compile_expression(part.replace("_SH", "_RP"))
        sources.append(_digital(source) if part.startswith("_TT") else source)

    def run(c: Context) -> Outcome:
        if len(sources) > c.machine.options.channels:
            raise CommandError(4)
        for source in sources:
            source(c)
        c.machine.recorder.sources = list(sources)
        return None

    return run


@command("RC")
def _record(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.show_value(fixed.whole(int(c.machine.recorder.running)))
    fields = values(parse_fields(text, 2))

    def run(c: Context) -> Outcome:
        given = [None if raw is None else fixed.truncated(raw) for raw in [*fields(c), None]]
        exponent, records = given[0], given[1]
        if exponent is None:
            raise CommandError(50)
        if not 0 <= exponent <= 8 or (records is not None and not -8000 <= records <= 8000):
            raise CommandError(6)
        recorder = c.machine.recorder
        recorder.start(exponent, records, c.machine.timebase.next_sample())
        recorder.run(c.machine.now())
        return None

    return run


# Listings and the program


def listing(op: str, lines: Callable[[Context], list[str]], table: dict[str, Command] = COMMANDS) -> None:
    """Enter a command that tells lines of text."""

    @command(op, table=table)
    def compile_listing(text: str) -> Runner:
        bare(text.removeprefix("?"))

        def run(c: Context) -> Outcome:
            written = "".join(f"{line}\r\n" for line in lines(c))
            if c.thread is not None:
                c.machine.ports.message(written)
                return None
            return Raw(written)

        return run

    del compile_listing


listing("LA", lambda c: c.machine.data.list_arrays())
listing("LL", lambda c: c.machine.program.list_labels())
listing("LV", lambda c: c.machine.data.list_variables())


@command("LS", where="line", lock="13")
def _list_program(text: str) -> Runner:
    parts = split(text)
    if len(parts) > 2:
        raise CommandError(4)
    places: list[Callable[[Context], int] | None] = [_place(part) if part else None for part in [*parts, ""]]

    def run(c: Context) -> Outcome:
        lines = c.machine.program.lines
        first = places[0](c) if places[0] is not None else 0
        last = places[1](c) if places[1] is not None else len(lines) - 1
        if first < 0 or first >= c.machine.model.room.lines or last >= c.machine.model.room.lines:
            raise CommandError(11)
        return Raw(
            "".join(f"{number:03d} {lines[number]}\r\n" for number in range(first, min(last, len(lines) - 1) + 1))
        )

    return run


def _place(text: str) -> Callable[[Context], int]:
    if text.startswith("#"):
        return lambda c: c.machine.program.line_of(text[1:])
    return integer(text)


@command("UL", where="line", lock="13")
def _upload(text: str) -> Runner:
    bare(text)
    return lambda c: Raw("".join(f"{line}\r\n" for line in c.machine.program.lines) + END_OF_TEXT + "\r\n")


@command("DL", where="line", lock="1")
def _download(text: str) -> Runner:
    if text and not text.startswith("#"):
        raise CommandError(4)

    def run(c: Context) -> Outcome:
        machine, program = c.machine, c.machine.program
        if machine.interpreter.any_running():
            raise CommandError(17)
        if not text:
            program.clear()
            at = 0
        else:
            at = len(program.lines) if text == "#" else program.line_of(text[1:]) + 1

        def finish(loaded: str) -> None:
            program.insert(at, program_lines(loaded))

        if c.port is not None:
            c.port.download = finish
        return None

    return run


def program_lines(loaded: str) -> list[str]:
    """The lines of a downloaded text; line feeds are not part of it."""
    lines = loaded.replace("\n", "").split("\r")
    if lines and not lines[-1]:
        lines.pop()
    return lines
