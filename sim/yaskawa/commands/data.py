"""Formats, messages, arrays, listings, download and upload (L3971-L4226, L6698-L7564, L8267-L9394, L11125-L11391)."""

import re
from collections.abc import Callable

from sim.yaskawa.base import fixed
from sim.yaskawa.base.errors import CommandError
from sim.yaskawa.base.formats import NumberFormat, NumberLayout
from sim.yaskawa.language.arguments import compile_values, parse_fields, split_fields
from sim.yaskawa.language.context import CommandContext, Evaluator
from sim.yaskawa.language.expressions import compile_expression, compile_integer
from sim.yaskawa.language.registry import COMMANDS, CommandDefinition, Outcome, Runner, register_command, require_bare
from sim.yaskawa.language.statements import RawData, local_format
from sim.yaskawa.ports.ports import END_OF_TEXT

_BRACES = re.compile(r"\{[^{}]*\}")


@register_command("PF")
def _compile_position_format(text: str) -> Runner:
    """One format for all axes; of several, as in L16428 (SMC-2000: L1502), the first counts."""
    if text == "?":
        return lambda c: c.machine.format_answer("PF", c.machine.position_format.as_number)
    value = compile_expression(split_fields(text)[0])

    def run_command(c: CommandContext) -> Outcome:
        c.machine.position_format = NumberFormat.from_number(value(c))
        return None

    return run_command


@register_command("VF")
def _compile_variable_format(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_answer("VF", c.machine.variable_format.as_number)
    value = compile_expression(text)

    def run_command(c: CommandContext) -> Outcome:
        c.machine.variable_format = NumberFormat.from_number(value(c))
        return None

    return run_command


@register_command("LZ")
def _compile_leading_zeros(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_variable(fixed.from_integer(int(c.machine.layout.strip_zeros)))
    value = compile_integer(text)

    def run_command(c: CommandContext) -> Outcome:
        number = value(c)
        if number not in (0, 1):
            raise CommandError(6)
        c.machine.layout = NumberLayout(number == 1, c.machine.layout.sign_column)
        return None

    return run_command


# Messages

Part = Callable[[CommandContext], str]


@register_command("MG")
def _compile_message(text: str) -> Runner:
    target = ""
    if text.startswith("{E"):
        target, text = text[2:3], text[4:].lstrip(",")
        if not "A" <= target <= "H":
            raise CommandError(53)
    elif text.startswith("{P"):
        target, text = "2" if text[2:3] == "2" else "S", text[4:].lstrip(",")
    line_end = True
    parts: list[Part] = []
    for piece in split_fields(text):
        for part in _split_pieces(piece):
            if part in ("{N}", "{n}"):
                line_end = False
            else:
                parts.append(_compile_part(part))

    def run_command(c: CommandContext) -> Outcome:
        message = "".join(part(c) for part in parts)
        if target:
            if not c.machine.ports.is_port_open(target):
                raise CommandError(126)
            c.machine.ports.send_text(target, f"{message}\r\n" if line_end else message)
        elif c.thread is not None:
            c.machine.ports.send_message(f"{message}\r\n" if line_end else message)
        else:
            return message if line_end else RawData(message)
        return None

    return run_command


def _split_pieces(piece: str) -> list[str]:
    """Split a field of MG where braces follow it without a separator (`{^07}{^255}`, `V{F4.2}{N}`)."""
    pieces: list[str] = []
    remainder = piece
    while remainder:
        if remainder.startswith("{"):
            end = remainder.find("}")
            if end < 0:
                raise CommandError(53)
            pieces.append(remainder[: end + 1])
            remainder = remainder[end + 1 :]
            continue
        if remainder.startswith('"'):
            end = remainder.find('"', 1)
            if end < 0:
                raise CommandError(52)
            pieces.append(remainder[: end + 1])
            remainder = remainder[end + 1 :]
            continue
        end = remainder.find("{")
        value = remainder if end < 0 else remainder[:end]
        remainder = "" if end < 0 else remainder[end:]
        match = _BRACES.match(remainder)
        if match is not None and match[0][1:2] in ("F", "$", "S"):
            value += match[0]
            remainder = remainder[match.end() :]
        pieces.append(value)
    return pieces


def _compile_part(text: str) -> Part:
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
    return lambda c: c.machine.format_variable(value(c))


# Arrays

_FREED = re.compile(r"(\*|[A-Za-z][A-Za-z0-9]*|\*\*)(\[0\])?")
_DIMENSION = re.compile(r"([A-Za-z][A-Za-z0-9]*)\[(.+)\]")


@register_command("DM")
def _compile_dimension(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_variable(fixed.from_integer(c.machine.data.free_elements()))
    requests: list[tuple[str, Callable[[CommandContext], int]]] = []
    for part in split_fields(text):
        match = _DIMENSION.fullmatch(part)
        if match is None:
            raise CommandError(55 if part else 50)
        requests.append((match[1], compile_integer(match[2])))

    def run_command(c: CommandContext) -> Outcome:
        for name, size in requests:
            c.machine.data.create_array(name, size(c), proper=c.machine.model.proper_arrays)
        return None

    return run_command


@register_command("DA")
def _compile_deallocate(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_variable(fixed.from_integer(30 - len(c.machine.data.arrays)))
    names = split_fields(text)
    if any(_FREED.fullmatch(name) is None for name in names):
        raise CommandError(4 if text else 50)

    def run_command(c: CommandContext) -> Outcome:
        for name in names:
            c.machine.data.delete_name(name)
        return None

    return run_command


def array_name(text: str) -> str:
    """Return the name in `NAME[]`."""
    if not text.endswith("[]"):
        raise CommandError(55)
    return text[:-2]


def element_span(c: CommandContext, size: int, given: list[int | None]) -> tuple[int, int]:
    """Return the first and last element of a transfer."""
    first = 0 if given[0] is None else fixed.to_integer(given[0])
    last = size - 1 if given[1] is None else fixed.to_integer(given[1])
    if not 0 <= first <= last < size:
        raise CommandError(56)
    return first, last


@register_command("QD")
def _compile_download_array(text: str) -> Runner:
    name_text, *field_texts = split_fields(text)
    name = array_name(name_text)
    fields = compile_values(parse_fields(",".join(field_texts), 2))

    def run_command(c: CommandContext) -> Outcome:
        port = c.port or (None if c.machine.model.still_data else c.machine.ports.serial)
        if port is None:
            raise CommandError(3)
        if c.machine.model.still_data and c.machine.motion.is_active():
            raise CommandError(7)
        array = c.machine.data.get_array(name)
        first, last = element_span(c, len(array), [*fields(c), None])

        def store_download(loaded: str) -> None:
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

        port.download = store_download
        return None

    return run_command


@register_command("QU")
def _compile_upload_array(text: str) -> Runner:
    name_text, *field_texts = split_fields(text)
    name = array_name(name_text)
    fields = compile_values(parse_fields(",".join(field_texts), 3))

    def run_command(c: CommandContext) -> Outcome:
        if c.machine.motion.is_active():
            raise CommandError(7)
        array = c.machine.data.get_array(name)
        given_fields = [*fields(c), None, None]
        first, last = element_span(c, len(array), given_fields)
        comma = given_fields[2] is not None and fixed.to_integer(given_fields[2]) == 1
        numbers = [c.machine.position_format.format_value(raw, c.machine.layout) for raw in array[first : last + 1]]
        message = (",".join(numbers) if comma else "\r".join(numbers)) + ("" if comma else "\r") + END_OF_TEXT
        if c.port is None:
            c.machine.ports.send_message(message)
            return None
        return message

    return run_command


@register_command("RA")
def _compile_record_arrays(text: str) -> Runner:
    names = [array_name(part) for part in split_fields(text)]

    def run_command(c: CommandContext) -> Outcome:
        if len(names) > c.machine.options.channel_count:
            raise CommandError(4)
        for name in names:
            c.machine.data.get_array(name)
        c.machine.recorder.arrays = list(names)
        return None

    return run_command


def _to_converter(volts: Evaluator) -> Evaluator:
    """Convert a torque to the converter's number, which is recorded (L16029; SMC-2000: L4621)."""
    return lambda c: fixed.from_integer(round(volts(c) / fixed.ONE * _DIGITAL_TORQUE / _FULL_VOLTS))


_DIGITAL_TORQUE = 32703
_FULL_VOLTS = 9.9988
_RECORDED = ("DE", "TP", "TE", "SH", "RP", "RL", "TI", "OP", "TS", "SC", "TB", "TT")


@register_command("RD")
def _compile_record_data(text: str) -> Runner:
    sources: list[Evaluator] = []
    for part in split_fields(text):
        if not part.startswith("_") or part[1:3] not in _RECORDED:
            raise CommandError(58)
        source = compile_expression(part.replace("_SH", "_RP"))
        sources.append(_to_converter(source) if part.startswith("_TT") else source)

    def run_command(c: CommandContext) -> Outcome:
        if len(sources) > c.machine.options.channel_count:
            raise CommandError(4)
        for source in sources:
            source(c)
        c.machine.recorder.sources = list(sources)
        return None

    return run_command


@register_command("RC")
def _compile_record(text: str) -> Runner:
    if text == "?":
        return lambda c: c.machine.format_variable(fixed.from_integer(int(c.machine.recorder.running)))
    fields = compile_values(parse_fields(text, 2))

    def run_command(c: CommandContext) -> Outcome:
        values = [None if raw is None else fixed.to_integer(raw) for raw in [*fields(c), None]]
        exponent, records = values[0], values[1]
        if exponent is None:
            raise CommandError(50)
        if not 0 <= exponent <= 8 or (records is not None and not -8000 <= records <= 8000):
            raise CommandError(6)
        recorder = c.machine.recorder
        recorder.start_recording(exponent, records, c.machine.timebase.next_sample())
        recorder.record_due(c.machine.current_sample())
        return None

    return run_command


# Listings and the program


def register_listing(
    op: str, lines: Callable[[CommandContext], list[str]], table: dict[str, CommandDefinition] = COMMANDS
) -> None:
    """Register a command that reports lines of text."""

    @register_command(op, table=table)
    def compile_listing(text: str) -> Runner:
        require_bare(text.removeprefix("?"))

        def run_command(c: CommandContext) -> Outcome:
            message = "".join(f"{line}\r\n" for line in lines(c))
            if c.thread is not None:
                c.machine.ports.send_message(message)
                return None
            return RawData(message)

        return run_command

    del compile_listing


register_listing("LA", lambda c: c.machine.data.list_arrays())
register_listing("LL", lambda c: c.machine.program.list_labels())
register_listing("LV", lambda c: c.machine.data.list_variables())


@register_command("LS", where="line", lock="13")
def _compile_list_program(text: str) -> Runner:
    parts = split_fields(text)
    if len(parts) > 2:
        raise CommandError(4)
    places: list[Callable[[CommandContext], int] | None] = [
        _compile_place(part) if part else None for part in [*parts, ""]
    ]

    def run_command(c: CommandContext) -> Outcome:
        lines = c.machine.program.lines
        first = places[0](c) if places[0] is not None else 0
        last = places[1](c) if places[1] is not None else len(lines) - 1
        if first < 0 or first >= c.machine.model.room.lines or last >= c.machine.model.room.lines:
            raise CommandError(11)
        return RawData(
            "".join(f"{number:03d} {lines[number]}\r\n" for number in range(first, min(last, len(lines) - 1) + 1))
        )

    return run_command


def _compile_place(text: str) -> Callable[[CommandContext], int]:
    if text.startswith("#"):
        return lambda c: c.machine.program.find_label(text[1:])
    return compile_integer(text)


@register_command("UL", where="line", lock="13")
def _compile_upload(text: str) -> Runner:
    require_bare(text)

    def run_command(c: CommandContext) -> Outcome:
        end = "\r\n" if c.machine.options.upload_line_end else ""
        return RawData("".join(f"{line}\r\n" for line in c.machine.program.lines) + END_OF_TEXT + end)

    return run_command


@register_command("DL", where="line", lock="1")
def _compile_download(text: str) -> Runner:
    if text and not text.startswith("#"):
        raise CommandError(4)

    def run_command(c: CommandContext) -> Outcome:
        machine, program = c.machine, c.machine.program
        if machine.programs.any_running():
            raise CommandError(17)
        if not text:
            program.clear_lines()
            at = 0
        else:
            at = len(program.lines) if text == "#" else program.find_label(text[1:]) + 1

        def store_download(loaded: str) -> None:
            program.insert_lines(at, program_lines(loaded))

        if c.port is not None:
            c.port.download = store_download
        return None

    return run_command


def program_lines(loaded: str) -> list[str]:
    """Split a downloaded text into lines; line feeds are not part of it."""
    lines = loaded.replace("\n", "").split("\r")
    if lines and not lines[-1]:
        lines.pop()
    return lines
