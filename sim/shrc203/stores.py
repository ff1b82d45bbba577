"""Commands for stored data: programs (P:), memory switches (MS:), registrations (PIT:, PAV:)."""

from sim.shrc203.grammar import CommandRefused, parse_integer
from sim.shrc203.line import Reply
from sim.shrc203.moves import move_to_coordinates
from sim.shrc203.program_lines import LINES, NONE, PROGRAMS, parse_line
from sim.shrc203.registration import RECORDS
from sim.shrc203.unit import CommandArea, StageSystem

_ITEMS = 9


def execute_program_command(unit: StageSystem, text: str, reply: Reply) -> str:
    """P:… (L5479-L7314)."""
    if unit.area is CommandArea.HOST:
        if text != "R":
            raise CommandRefused
        unit.require_ready()
        unit.area = CommandArea.PROGRAM
    elif unit.area is CommandArea.PROGRAM:
        _run_program(unit, text, reply)
    else:
        return _edit_program(unit, text)
    return "OK"


def _run_program(unit: StageSystem, text: str, reply: Reply) -> None:
    run = unit.program
    if text in ("E", "U0", "U1"):
        # The manual names no state in which these are refused (L5578-L5606).
        {"E": run.stop_program, "U0": run.pause_program, "U1": run.resume_program}[text]()
        return
    if run.is_running:
        raise CommandRefused
    unit.require_ready()
    if text == "O":
        unit.start_reporting(reply)
        run.run_one_line()
    elif text == "C0" or text == "C1":
        run.report_end = text == "C1"
    elif text == "T0" or text == "T1":
        run.report_triggers = text == "T1"
    elif text == "S":
        unit.start_reporting(reply)
        run.start_program()
    elif text == "H":
        run.stop_program()
        unit.area = CommandArea.HOST
    elif text == "ON":
        run.stop_program()
        unit.programs.begin_edit()
        unit.area = CommandArea.PROGRAM_EDIT
    elif text[:1] == "P":
        number = parse_integer(text[1:], 1, PROGRAMS)
        run.stop_program()
        unit.programs.selected, run.line = number, 1
    else:
        raise CommandRefused


def _edit_program(unit: StageSystem, text: str) -> str:
    programs = unit.programs
    verb, *fields = text.split(",")
    if verb == "OFF" and not fields:
        programs.save_edited()
        unit.area = CommandArea.PROGRAM
    elif verb == "INIT" and not fields:
        programs.clear_lines()
    elif verb in ("DEL", "GET") and len(fields) == 1:
        number = parse_integer(fields[0], 1, LINES)
        if verb == "GET":
            return programs.get_line(number).text
        programs.put_line(number, NONE)
    elif verb == "SET" and len(fields) >= 2:
        programs.put_line(parse_integer(fields[0], 1, LINES), parse_line(fields[1:]))
    else:
        raise CommandRefused
    return "OK"


def execute_switch_command(unit: StageSystem, text: str, reply: Reply) -> str:
    """MS:… (L7316-L7690)."""
    del reply
    if unit.area is CommandArea.HOST:
        if text != "ON":
            raise CommandRefused
        unit.require_ready()
        unit.switches.begin_edit()
        unit.area = CommandArea.SWITCHES
        return "OK"
    if text == "OFF":
        unit.area = CommandArea.HOST
        unit.restart_due = unit.switches.save_edited()
        return "OK"
    verb, *fields = text.split(",")
    if not fields:
        raise CommandRefused
    item = parse_integer(fields[0], 0, _ITEMS - 1)
    if verb.endswith("K"):
        return _whole_item(unit, verb, item, fields[1:])
    if len(fields) != (3 if verb == "SET" else 2):
        raise CommandRefused
    return _one_content(unit, verb, item, fields[1:])


def _whole_item(unit: StageSystem, verb: str, item: int, values: list[str]) -> str:
    if verb == "SETK":
        unit.switches.put_item(item, values)
        return "OK"
    if values:
        raise CommandRefused
    if verb == "GETK":
        return ",".join(unit.switches.edited_texts(item))
    if verb == "DEFRK":
        return ",".join(unit.switches.default_texts(item))
    if verb != "DEFK":
        raise CommandRefused
    unit.switches.restore_item(item)
    return "OK"


def _one_content(unit: StageSystem, verb: str, item: int, values: list[str]) -> str:
    content = parse_integer(values[0], 0, len(unit.switches.edited_texts(item)) - 1)
    if verb == "GET":
        return unit.switches.edited_texts(item)[content]
    if verb == "DEFR":
        return unit.switches.default_texts(item)[content]
    if verb == "SET":
        unit.switches.put_content(item, content, values[1])
    elif verb == "DEF":
        unit.switches.restore_content(item, content)
    else:
        raise CommandRefused
    return "OK"


def execute_position_record(unit: StageSystem, text: str, reply: Reply) -> str:
    """PIT:… (L7692-L7802)."""
    records = unit.registrations.stage_positions
    verb, number = _parse_record(text)
    if verb == "SET":
        unit.require_ready()
        records[number] = _build_record([axis.position for axis in unit.axes])
        return "OK"
    if number in records:
        if verb == "DEL":
            return _delete_record(unit, records, number)
        offsets = [axis.offset for axis in unit.axes]
        record = _build_record([position + offset for position, offset in zip(records[number], offsets, strict=True)])
        return _recall_record(unit, verb, record, reply)
    return _answer_without_record(unit, verb)


def execute_coordinate_record(unit: StageSystem, text: str, reply: Reply) -> str:
    """PAV:… (L7804-L7911)."""
    records = unit.registrations.coordinates
    verb, number = _parse_record(text)
    if verb == "SET":
        unit.require_ready()
        records[number] = _build_record([axis.position + axis.offset for axis in unit.axes])
        return "OK"
    if number in records:
        if verb == "DEL":
            return _delete_record(unit, records, number)
        return _recall_record(unit, verb, records[number], reply)
    return _answer_without_record(unit, verb)


Record = tuple[int, int, int]


def _parse_record(text: str) -> tuple[str, int]:
    verb, *fields = text.split(",")
    if len(fields) != 1:
        raise CommandRefused
    return verb, parse_integer(fields[0], 1, RECORDS)


def _build_record(values: list[int]) -> Record:
    return values[0], values[1], values[2]


def _delete_record(unit: StageSystem, records: dict[int, Record], number: int) -> str:
    unit.require_ready()
    del records[number]
    return "OK"


def _recall_record(unit: StageSystem, verb: str, here: Record, reply: Reply) -> str:
    if verb == "GET":
        return ",".join(str(value) for value in here)
    if verb in ("G", "GRT"):
        move_to_coordinates(unit, here, reply if verb == "GRT" else None)
    else:
        raise CommandRefused
    return "OK"


def _answer_without_record(unit: StageSystem, verb: str) -> str:
    """Handle an empty record: deleting is harmless, all else is NG (decision 38)."""
    if verb != "DEL":
        raise CommandRefused
    unit.require_ready()
    return "OK"
