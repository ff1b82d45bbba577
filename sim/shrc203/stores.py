"""Commands of what the unit stores: programs (P:), memory switches (MS:), registrations (PIT:, PAV:)."""

from sim.shrc203.grammar import Refused, integer
from sim.shrc203.line import Reply
from sim.shrc203.moves import go_to
from sim.shrc203.program_lines import LINES, NONE, PROGRAMS, parse_line
from sim.shrc203.registration import RECORDS
from sim.shrc203.unit import Area, Unit

_ITEMS = 9


def program(unit: Unit, text: str, reply: Reply) -> str:
    """P:… (L5479-L7314)."""
    if unit.area is Area.HOST:
        if text != "R":
            raise Refused
        unit.need_ready()
        unit.area = Area.PROGRAM
    elif unit.area is Area.PROGRAM:
        _run_program(unit, text, reply)
    else:
        return _edit_program(unit, text)
    return "OK"


def _run_program(unit: Unit, text: str, reply: Reply) -> None:
    run = unit.program
    if text in ("E", "U0", "U1"):
        # The manual names no state in which these are refused (L5578-L5606).
        {"E": run.stop, "U0": run.pause, "U1": run.resume}[text]()
        return
    if run.running:
        raise Refused
    unit.need_ready()
    if text == "O":
        unit.start_reporting(reply)
        run.one_line()
    elif text == "C0" or text == "C1":
        run.report_end = text == "C1"
    elif text == "T0" or text == "T1":
        run.report_triggers = text == "T1"
    elif text == "S":
        unit.start_reporting(reply)
        run.start()
    elif text == "H":
        run.stop()
        unit.area = Area.HOST
    elif text == "ON":
        run.stop()
        unit.programs.begin_edit()
        unit.area = Area.PROGRAM_EDIT
    elif text[:1] == "P":
        number = integer(text[1:], 1, PROGRAMS)
        run.stop()
        unit.programs.selected, run.line = number, 1
    else:
        raise Refused


def _edit_program(unit: Unit, text: str) -> str:
    programs = unit.programs
    verb, *fields = text.split(",")
    if verb == "OFF" and not fields:
        programs.save()
        unit.area = Area.PROGRAM
    elif verb == "INIT" and not fields:
        programs.clear()
    elif verb in ("DEL", "GET") and len(fields) == 1:
        number = integer(fields[0], 1, LINES)
        if verb == "GET":
            return programs.get(number).text
        programs.put(number, NONE)
    elif verb == "SET" and len(fields) >= 2:
        programs.put(integer(fields[0], 1, LINES), parse_line(fields[1:]))
    else:
        raise Refused
    return "OK"


def switches(unit: Unit, text: str, reply: Reply) -> str:
    """MS:… (L7316-L7690)."""
    del reply
    if unit.area is Area.HOST:
        if text != "ON":
            raise Refused
        unit.need_ready()
        unit.switches.begin()
        unit.area = Area.SWITCHES
        return "OK"
    if text == "OFF":
        unit.area = Area.HOST
        unit.restart_due = unit.switches.save()
        return "OK"
    verb, *fields = text.split(",")
    if not fields:
        raise Refused
    item = integer(fields[0], 0, _ITEMS - 1)
    if verb.endswith("K"):
        return _whole_item(unit, verb, item, fields[1:])
    if len(fields) != (3 if verb == "SET" else 2):
        raise Refused
    return _one_content(unit, verb, item, fields[1:])


def _whole_item(unit: Unit, verb: str, item: int, values: list[str]) -> str:
    if verb == "SETK":
        unit.switches.put_all(item, values)
        return "OK"
    if values:
        raise Refused
    if verb == "GETK":
        return ",".join(unit.switches.edited(item))
    if verb == "DEFRK":
        return ",".join(unit.switches.defaults(item))
    if verb != "DEFK":
        raise Refused
    unit.switches.restore_all(item)
    return "OK"


def _one_content(unit: Unit, verb: str, item: int, values: list[str]) -> str:
    content = integer(values[0], 0, len(unit.switches.edited(item)) - 1)
    if verb == "GET":
        return unit.switches.edited(item)[content]
    if verb == "DEFR":
        return unit.switches.defaults(item)[content]
    if verb == "SET":
        unit.switches.put(item, content, values[1])
    elif verb == "DEF":
        unit.switches.restore(item, content)
    else:
        raise Refused
    return "OK"


def places(unit: Unit, text: str, reply: Reply) -> str:
    """PIT:… (L7692-L7802)."""
    records = unit.registrations.places
    verb, number = _record(text)
    if verb == "SET":
        unit.need_ready()
        records[number] = _triple([axis.position for axis in unit.axes])
        return "OK"
    if number in records:
        offsets = [axis.offset for axis in unit.axes]
        here = _triple([place + offset for place, offset in zip(records[number], offsets, strict=True)])
        return _recall(unit, verb, number, records, here, reply)
    return _without_record(unit, verb)


def coordinates(unit: Unit, text: str, reply: Reply) -> str:
    """PAV:… (L7804-L7911)."""
    records = unit.registrations.coordinates
    verb, number = _record(text)
    if verb == "SET":
        unit.need_ready()
        records[number] = _triple([axis.position + axis.offset for axis in unit.axes])
        return "OK"
    if number in records:
        return _recall(unit, verb, number, records, records[number], reply)
    return _without_record(unit, verb)


Record = tuple[int, int, int]


def _record(text: str) -> tuple[str, int]:
    verb, *fields = text.split(",")
    if len(fields) != 1:
        raise Refused
    return verb, integer(fields[0], 1, RECORDS)


def _triple(values: list[int]) -> Record:
    return values[0], values[1], values[2]


def _recall(unit: Unit, verb: str, number: int, records: dict[int, Record], here: Record, reply: Reply) -> str:
    if verb == "GET":
        return ",".join(str(value) for value in here)
    if verb == "DEL":
        unit.need_ready()
        del records[number]
    elif verb in ("G", "GRT"):
        go_to(unit, here, reply if verb == "GRT" else None)
    else:
        raise Refused
    return "OK"


def _without_record(unit: Unit, verb: str) -> str:
    """Nothing is registered: deleting is harmless, the rest NG (decision 38)."""
    if verb != "DEL":
        raise Refused
    unit.need_ready()
    return "OK"
