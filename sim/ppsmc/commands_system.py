"""Direct commands that do not move axes: block, program, i/o, counter, files, panel, network (section 12.2, 12.5)."""

import datetime
import ipaddress
import re
from fractions import Fraction

from orchestrator.clock.base import NS_PER_S
from sim.ppsmc.axis import NO_ERROR
from sim.ppsmc.grammar import Refused, after_colon, decimal, integer, leading_axis, nothing, plain
from sim.ppsmc.registry import Command, Commands, When
from sim.ppsmc.unit import Client, Handler, Restart, Unit

_FIELDS = re.compile(r"(\d{1,2}):(\d{1,2}):(\d{1,2})")
_START = re.compile(r"(\d{0,2})(?::(\d*))?(?:\*(\d+))?")
_FILE_NAME = re.compile(r'[^\\/:*?"<>|\x00-\x1f]{1,64}')
_FIRST_PASSWORD, _LAST_PASSWORD = 10_000_000, 99_999_999
_SEPARATORS = {"cr": "\r", "lf": "\n", "crlf": "\r\n", "sp": " ", "tab": "\t"}
_MASK = "255.255.255.0"
_MOST_SLEEP_S = 1_000_000
_MOST_FILE = 1_000_000


def _flag(name: str, low: int, high: int) -> Handler:
    """A command that sets attribute `name` of the unit to a number."""

    def run(unit: Unit, client: Client, rest: str) -> None:
        del client
        value = integer(rest.removeprefix(":"), low, high)
        setattr(unit, name, bool(value) if high == 1 else value)

    return run


def _switch(name: str, value: bool) -> Handler:
    def run(unit: Unit, client: Client, rest: str) -> None:
        del client
        nothing(rest)
        setattr(unit, name, value)

    return run


# Whole unit


def _block(unit: Unit, client: Client, rest: str) -> None:
    del client
    nothing(rest)
    unit.stop_all()
    unit.blocked = True
    unit.buffers_due = True


def _restart(restart: Restart) -> Handler:
    def run(unit: Unit, client: Client, rest: str) -> None:
        del client
        nothing(rest)
        unit.restart_due = restart

    return run


def _cerr(unit: Unit, client: Client, rest: str) -> None:
    del client
    number, rest = leading_axis(rest)
    nothing(rest)
    for axis in unit.machine.some(number or None):
        axis.error = NO_ERROR
        axis.oscillation_error = False


def _iel(unit: Unit, client: Client, rest: str) -> None:
    del client
    unit.disk.ignore_limits = bool(integer(rest, 0, 1))


def _us(unit: Unit, client: Client, rest: str) -> None:
    """Clamped to 32 bits (decision 27)."""
    del client
    value = integer(rest.removeprefix(":"), -(10**20), 10**20)
    unit.user_status = max(-(2**31), min(2**31 - 1, value))


def _sleep(unit: Unit, client: Client, rest: str) -> None:
    """Only for an idle unit (decision 28)."""
    if not unit.idle and not unit.options.sleep_while_moving:
        raise Refused("not allowed during positioning")
    seconds = decimal(rest.removeprefix(":"))
    if not 0 <= seconds <= _MOST_SLEEP_S:
        raise Refused("interval out of range")
    client.sleep(round(seconds * NS_PER_S))


# Program


def _start(unit: Unit, client: Client, rest: str) -> None:
    match = _START.fullmatch(rest.replace(" ", "").rstrip(";"))
    if match is None:
        raise Refused("not a start")
    axis = unit.machine.axis(int(match[1])).number if match[1] else None
    first = int(match[2]) if match[2] else None
    repetitions = integer(match[3], 1, 2**31 - 1) if match[3] else 1
    if not unit.disk.ignore_limits and unit.machine.any_limit:
        raise Refused("limit switch active")
    unit.runner.start(first, axis, repetitions, client.say)


def _clr(unit: Unit, client: Client, rest: str) -> None:
    del client
    nothing(rest)
    unit.memory.clear()


def _file_name(text: str) -> str:
    text = text.strip().lower()
    if not _FILE_NAME.fullmatch(text):
        raise Refused("not a file name")
    return text


def _program_name(rest: str) -> str:
    return _file_name(after_colon(rest)) if rest else "last"


def _save(unit: Unit, client: Client, rest: str) -> None:
    del client
    unit.disk.programs[_program_name(rest)] = unit.memory.listing


def _load(unit: Unit, client: Client, rest: str) -> None:
    del client
    name = _program_name(rest)
    if name not in unit.disk.programs:
        raise Refused(f"no file {name}.smc")
    unit.memory.load(unit.disk.programs[name])


def _list(unit: Unit, client: Client, rest: str) -> None:
    nothing(rest)
    for name in sorted(unit.disk.programs):
        client.say(f"{name}.smc")


# Data files


def _fwrite(unit: Unit, client: Client, rest: str) -> None:
    """Append to a file; without an axis, axis 1 is meant (L1963-L2001)."""
    del client
    number, rest = leading_axis(rest)
    axis = unit.machine.axis(1 if number is None else number)
    name, star, what = after_colon(rest).partition("*")
    name, what = _file_name(name), what.strip().lower()
    if not star:
        raise Refused("'*' missing")
    drive, places = unit.machine.drive, axis.settings.dcpl
    match what:
        case "a":
            text = axis.name
        case "p":
            text = plain(axis.distance(drive.counter(axis)), places)
        case "e":
            text = plain(unit.machine.measured(axis), places)
        case "ec":
            text = str(axis.increments(drive.exact(axis)[0]))
        case _ if what in _SEPARATORS:
            text = _SEPARATORS[what]
        case _:
            raise Refused(f"unknown parameter '{what}'")
    content = unit.disk.files.get(name, "") + text
    if len(content) > _MOST_FILE:
        raise Refused("disk full")
    unit.disk.files[name] = content


def _fget(unit: Unit, client: Client, rest: str) -> None:
    name = _file_name(after_colon(rest))
    if name not in unit.disk.files:
        raise Refused(f"no file {name}")
    for line in unit.disk.files[name].splitlines():
        client.say(line)


def _fdelete(unit: Unit, client: Client, rest: str) -> None:
    del client
    name = _file_name(after_colon(rest))
    if unit.disk.files.pop(name, None) is None:
        raise Refused(f"no file {name}")


# I/o, filter, screen, counter


def _dout(unit: Unit, client: Client, rest: str) -> None:
    del client
    unit.machine.outputs = integer(rest.removeprefix(":"), 0, 255)


def _dfi(unit: Unit, client: Client, rest: str) -> None:
    del client
    unit.runner.filter = integer(rest.removeprefix(":"), 1, 6)


def _dhs(unit: Unit, client: Client, rest: str) -> None:
    del client
    unit.runner.screen = integer(rest.removeprefix(":"), 0, 4)


def _ccnt(unit: Unit, client: Client, rest: str) -> None:
    del client
    nothing(rest)
    unit.counter.clear()


def _ccount(unit: Unit, client: Client, rest: str) -> None:
    del client
    nothing(rest)
    unit.counter.begin()


def _count(unit: Unit, client: Client, rest: str) -> None:
    del client
    interval = decimal(rest.removeprefix(":"))
    if not 1 <= interval <= Fraction(1000):
        raise Refused("interval out of range")
    unit.counter.count(round(interval * NS_PER_S), lambda _: None)


# Clock, password, network


def _date(unit: Unit, client: Client, rest: str) -> None:
    del client
    match = _FIELDS.fullmatch(rest)
    try:
        assert match is not None
        day, month, year = (int(part) for part in match.groups())
        unit.set_calendar(unit.calendar.replace(day=day, month=month, year=2000 + year))
    except (AssertionError, ValueError):
        raise Refused("not a date") from None


def _time(unit: Unit, client: Client, rest: str) -> None:
    del client
    match = _FIELDS.fullmatch(rest)
    try:
        assert match is not None
        hour, minute, second = (int(part) for part in match.groups())
        moment = datetime.time(hour, minute, second)
    except (AssertionError, ValueError):
        raise Refused("not a time") from None
    unit.set_calendar(datetime.datetime.combine(unit.calendar.date(), moment))


def _passwd(unit: Unit, client: Client, rest: str) -> None:
    del client
    old, colon, new = rest.partition(":")
    if not colon:
        raise Refused("':' missing")
    number = integer(new, 0, _LAST_PASSWORD)
    if (new.startswith(("0", "+")) and number) or 0 < number < _FIRST_PASSWORD:
        raise Refused("not a password")
    if integer(old, 0, _LAST_PASSWORD) != unit.disk.password:
        raise Refused("wrong password")
    unit.disk.password = number


def _network(rest: str) -> tuple[str, str]:
    address, _, mask = after_colon(rest).partition("*")
    mask = mask.strip() or _MASK
    try:
        ipaddress.IPv4Network(f"0.0.0.0/{mask}")
        return str(ipaddress.IPv4Address(address.strip())), mask
    except ValueError:
        raise Refused("not an address") from None


def _changeip(unit: Unit, client: Client, rest: str) -> None:
    del client
    unit.disk.address, unit.disk.mask = _network(rest)


def _changeip_eib(unit: Unit, client: Client, rest: str) -> None:
    del client
    unit.disk.eib_address, unit.disk.eib_mask = _network(rest)


def _reset_eib(unit: Unit, client: Client, rest: str) -> None:
    """The counters of the device begin at zero (L5037)."""
    del client
    nothing(rest)
    for axis in unit.machine.axes:
        if axis.encoder is not None:
            axis.encoder.load(0, axis.steps - axis.origin)


# Panel


def _page(unit: Unit, client: Client, rest: str) -> None:
    del client
    nothing(rest)
    if len(unit.machine.axes) <= 8:
        raise Refused("only with more than eight axes")
    unit.second_page = not unit.second_page


# Control COM port


def _cc_open(unit: Unit, client: Client, rest: str) -> None:
    del client
    nothing(rest)
    unit.com.open = True


def _cc_close(unit: Unit, client: Client, rest: str) -> None:
    del client
    nothing(rest)
    unit.com.open = False


def _cc_write(unit: Unit, client: Client, rest: str) -> None:
    del client
    text = after_colon(rest)
    if "*" in text:
        raise Refused("'*' is not allowed")
    if not unit.com.open:
        raise Refused("COM port not open")
    unit.com.write(text.replace(",", "."))


def _cc_read(unit: Unit, client: Client, rest: str) -> None:
    del client
    nothing(rest)
    if not unit.com.open:
        raise Refused("COM port not open")
    unit.com.read, unit.com.received = unit.com.received, ""


# File based write filter


def _fbwf(on: bool) -> Handler:
    def run(unit: Unit, client: Client, rest: str) -> None:
        del client
        nothing(rest)
        unit.disk.filter_next = on

    return run


def _fbwf_configure(unit: Unit, client: Client, rest: str) -> None:
    del client
    nothing(rest)
    unit.disk.filter_spares_files = True


def _fbwf_status(unit: Unit, client: Client, rest: str) -> None:
    nothing(rest)
    client.say(f"FBWF {'enabled' if unit.disk.filtered else 'disabled'}")


SYSTEM: Commands = {
    "block": Command(_block, When.ALWAYS, "cancel positioning tasks and block communication"),
    "cc_close": Command(_cc_close, When.IDLE, "close control com port"),
    "cc_open": Command(_cc_open, When.IDLE, "open control com port"),
    "cc_read": Command(_cc_read, When.IDLE, "read from control com port"),
    "cc_write": Command(_cc_write, When.IDLE, "write to control com port"),
    "ccnt": Command(_ccnt, When.IDLE, "clear counter memory", needs="counter"),
    "ccount": Command(_ccount, When.IDLE, "start continuous counting", needs="counter"),
    "cerr": Command(_cerr, When.IDLE, "clear error"),
    "changeip": Command(_changeip, When.IDLE, "change IP address"),
    "changeip_eib": Command(_changeip_eib, When.IDLE, "change EIB7 IP address", needs="eib7"),
    "clr": Command(_clr, When.IDLE, "clear program memory"),
    "count": Command(_count, When.IDLE, "start single count interval", needs="counter"),
    "date": Command(_date, When.ALWAYS, "set system date"),
    "dfi": Command(_dfi, When.IDLE, "set filter", needs="filter", names=("dfl",)),
    "dhs": Command(_dhs, When.IDLE, "set half screen", needs="half_screen"),
    "doff": Command(_switch("display", False), When.ALWAYS, "deactivate position display", names=("lcdoff",)),
    "don": Command(_switch("display", True), When.ALWAYS, "activate position display", names=("lcdon",)),
    "dout": Command(_dout, When.ALWAYS, "set i/o-port output", needs="io_port", names=("io",)),
    "echo": Command(_flag("echo", 0, 2), When.ALWAYS, "set status message level"),
    "fbwf_configure": Command(_fbwf_configure, When.IDLE, "configure FBWF", needs="fbwf"),
    "fbwf_disable": Command(_fbwf(False), When.IDLE, "disable FBWF", needs="fbwf"),
    "fbwf_enable": Command(_fbwf(True), When.IDLE, "enable FBWF", needs="fbwf"),
    "fbwf_status": Command(_fbwf_status, When.IDLE, "query FBWF status", needs="fbwf"),
    "fdelete": Command(_fdelete, When.IDLE, "delete file"),
    "fget": Command(_fget, When.IDLE, "transfer file"),
    "fwrite": Command(_fwrite, When.IDLE, "write parameter to file"),
    "iel": Command(_iel, When.IDLE, "ignore active limit switch"),
    "list": Command(_list, When.IDLE, "returns a list of available user programs"),
    "load": Command(_load, When.IDLE, "load program from harddisk"),
    "local": Command(_switch("local", True), When.ALWAYS, "activate LOCAL mode", names=("loc",)),
    "passwd": Command(_passwd, When.NOT_PROGRAM, "set administrator password"),
    "pg": Command(_page, When.ALWAYS, "switch to position display of axes 9-16"),
    "priority": Command(_flag("priority", 0, 3), When.ALWAYS, "set execution priority", names=("prio", "pri")),
    "reboot": Command(_restart(Restart.REBOOT), When.ALWAYS, "restart controller"),
    "remote": Command(_switch("local", False), When.ALWAYS, "activate REMOTE mode", names=("rem",)),
    "reset": Command(_restart(Restart.RESET), When.ALWAYS, "reset controller to power-on state", names=("clear",)),
    "reset_eib": Command(_reset_eib, When.IDLE, "reset an EIB7", needs="eib7"),
    "restart": Command(_restart(Restart.REBOOT), When.ALWAYS, "restart control program"),
    "save": Command(_save, When.IDLE, "save program to disk"),
    "shutdown": Command(_restart(Restart.SHUTDOWN), When.ALWAYS, "shutdown controller", names=("off",)),
    "sleep": Command(_sleep, When.ALWAYS, "delay command execution"),
    "sound": Command(_flag("sound", 0, 1), When.ALWAYS, "activate/deactivate acoustic signals"),
    "start": Command(_start, When.IDLE, "start program execution"),
    "time": Command(_time, When.ALWAYS, "set system time"),
    "txdel": Command(_flag("txdel", 0, 3), When.IDLE, "set delimiter for data transmission"),
    "txp": Command(_flag("stx", 0, 1), When.IDLE, "enable communication with STX/ETX"),
    "unblock": Command(_switch("blocked", False), When.ALWAYS, "resume communication", names=("unlock",), blocked=True),
    "us": Command(_us, When.ALWAYS, "set user status"),
}
"""Other direct commands by name. restart is the alias of reboot, allowed during motion (L1377, L2594)."""
