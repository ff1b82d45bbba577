"""Direct commands that do not move axes: block, program, i/o, counter, files, panel, network (section 12.2, 12.5)."""

import datetime
import ipaddress
import re
from fractions import Fraction

from orchestrator.clock.base import NS_PER_S
from sim.ppsmc.axis import NO_ERROR
from sim.ppsmc.grammar import (
    InputRefused,
    format_decimal,
    parse_decimal,
    parse_integer,
    require_end,
    split_axis,
    text_after_colon,
)
from sim.ppsmc.registry import CommandEntry, Commands, CommandUsage
from sim.ppsmc.unit import CommandClient, ControlProgram, Handler, RestartKind

_FIELDS = re.compile(r"(\d{1,2}):(\d{1,2}):(\d{1,2})")
_START = re.compile(r"(\d{0,2})(?::(\d*))?(?:\*(\d+))?")
_FILE_NAME = re.compile(r'[^\\/:*?"<>|\x00-\x1f]{1,64}')
_FIRST_PASSWORD, _LAST_PASSWORD = 10_000_000, 99_999_999
_SEPARATORS = {"cr": "\r", "lf": "\n", "crlf": "\r\n", "sp": " ", "tab": "\t"}
_MASK = "255.255.255.0"
_MOST_SLEEP_S = 1_000_000
_MOST_FILE = 1_000_000


def _flag_handler(name: str, low: int, high: int) -> Handler:
    """Make a command that sets attribute `name` of the control program to a number."""

    def set_flag(unit: ControlProgram, client: CommandClient, rest: str) -> None:
        del client
        value = parse_integer(rest.removeprefix(":"), low, high)
        setattr(unit, name, bool(value) if high == 1 else value)

    return set_flag


def _switch_handler(name: str, *, value: bool) -> Handler:
    def set_switch(unit: ControlProgram, client: CommandClient, rest: str) -> None:
        del client
        require_end(rest)
        setattr(unit, name, value)

    return set_switch


# Whole controller


def _execute_block(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    require_end(rest)
    unit.stop_all()
    unit.blocked = True
    unit.buffers_due = True


def _restart_handler(restart: RestartKind) -> Handler:
    def request_restart(unit: ControlProgram, client: CommandClient, rest: str) -> None:
        del client
        require_end(rest)
        unit.restart_due = restart

    return request_restart


def _execute_cerr(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    number, rest = split_axis(rest)
    require_end(rest)
    for axis in unit.machine.select_axes(number or None):
        axis.error = NO_ERROR
        axis.oscillation_error = False


def _execute_iel(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    unit.disk.ignore_limits = bool(parse_integer(rest, 0, 1))


def _execute_us(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """Clamped to 32 bits (decision 27)."""
    del client
    value = parse_integer(rest.removeprefix(":"), -(10**20), 10**20)
    unit.user_status = max(-(2**31), min(2**31 - 1, value))


def _execute_sleep(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """sleep: only for an idle controller (decision 28)."""
    if not unit.is_idle and not unit.options.sleep_while_moving:
        raise InputRefused("not allowed during positioning")
    seconds = parse_decimal(rest.removeprefix(":"))
    if not 0 <= seconds <= _MOST_SLEEP_S:
        raise InputRefused("interval out of range")
    client.delay_next(round(seconds * NS_PER_S))


# Program


def _execute_start(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    match = _START.fullmatch(rest.replace(" ", "").rstrip(";"))
    if match is None:
        raise InputRefused("not a start")
    axis = unit.machine.find_axis(int(match[1])).number if match[1] else None
    first = int(match[2]) if match[2] else None
    repetitions = parse_integer(match[3], 1, 2**31 - 1) if match[3] else 1
    if not unit.disk.ignore_limits and unit.machine.is_any_limit_on:
        raise InputRefused("limit switch active")
    unit.runner.start_program(first, axis, repetitions, client.send_reply)


def _execute_clr(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    require_end(rest)
    unit.memory.clear_program()


def _parse_file_name(text: str) -> str:
    text = text.strip().lower()
    if not _FILE_NAME.fullmatch(text):
        raise InputRefused("not a file name")
    return text


def _parse_program_name(rest: str) -> str:
    return _parse_file_name(text_after_colon(rest)) if rest else "last"


def _execute_save(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    unit.disk.programs[_parse_program_name(rest)] = unit.memory.list_commands


def _execute_load(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    name = _parse_program_name(rest)
    if name not in unit.disk.programs:
        raise InputRefused(f"no file {name}.smc")
    unit.memory.load_listing(unit.disk.programs[name])


def _execute_list(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    require_end(rest)
    for name in sorted(unit.disk.programs):
        client.send_reply(f"{name}.smc")


# Data files


def _execute_fwrite(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """fwrite: append to a file; without an axis, axis 1 is used (L1963-L2001)."""
    del client
    number, rest = split_axis(rest)
    axis = unit.machine.find_axis(1 if number is None else number)
    name, star, kind = text_after_colon(rest).partition("*")
    name, kind = _parse_file_name(name), kind.strip().lower()
    if not star:
        raise InputRefused("'*' missing")
    drive, places = unit.machine.drive, axis.settings.dcpl
    match kind:
        case "a":
            text = axis.name
        case "p":
            text = format_decimal(axis.steps_to_distance(drive.step_counter(axis)), places)
        case "e":
            text = format_decimal(unit.machine.measured_position(axis), places)
        case "ec":
            text = str(axis.encoder_increments(drive.exact_state(axis)[0]))
        case _ if kind in _SEPARATORS:
            text = _SEPARATORS[kind]
        case _:
            raise InputRefused(f"unknown parameter '{kind}'")
    content = unit.disk.files.get(name, "") + text
    if len(content) > _MOST_FILE:
        raise InputRefused("disk full")
    unit.disk.files[name] = content


def _execute_fget(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    name = _parse_file_name(text_after_colon(rest))
    if name not in unit.disk.files:
        raise InputRefused(f"no file {name}")
    for line in unit.disk.files[name].splitlines():
        client.send_reply(line)


def _execute_fdelete(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    name = _parse_file_name(text_after_colon(rest))
    if unit.disk.files.pop(name, None) is None:
        raise InputRefused(f"no file {name}")


# I/o, filter, screen, counter


def _execute_dout(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    unit.machine.output_byte = parse_integer(rest.removeprefix(":"), 0, 255)


def _execute_dfi(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    unit.runner.filter = parse_integer(rest.removeprefix(":"), 1, 6)


def _execute_dhs(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    unit.runner.screen = parse_integer(rest.removeprefix(":"), 0, 4)


def _execute_ccnt(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    require_end(rest)
    unit.counter.clear_memory()


def _execute_ccount(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    require_end(rest)
    unit.counter.begin_count()


def _execute_count(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    interval = parse_decimal(rest.removeprefix(":"))
    if not 1 <= interval <= Fraction(1000):
        raise InputRefused("interval out of range")
    unit.counter.count_interval(round(interval * NS_PER_S), lambda _: None)


# Clock, password, network


def _execute_date(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    match = _FIELDS.fullmatch(rest)
    try:
        assert match is not None
        day, month, year = (int(part) for part in match.groups())
        unit.set_system_clock(unit.system_clock.replace(day=day, month=month, year=2000 + year))
    except (AssertionError, ValueError):
        raise InputRefused("not a date") from None


def _execute_time(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    match = _FIELDS.fullmatch(rest)
    try:
        assert match is not None
        hour, minute, second = (int(part) for part in match.groups())
        moment = datetime.time(hour, minute, second)
    except (AssertionError, ValueError):
        raise InputRefused("not a time") from None
    unit.set_system_clock(datetime.datetime.combine(unit.system_clock.date(), moment))


def _execute_passwd(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    old, colon, new = rest.partition(":")
    if not colon:
        raise InputRefused("':' missing")
    number = parse_integer(new, 0, _LAST_PASSWORD)
    if (new.startswith(("0", "+")) and number) or 0 < number < _FIRST_PASSWORD:
        raise InputRefused("not a password")
    if parse_integer(old, 0, _LAST_PASSWORD) != unit.disk.password:
        raise InputRefused("wrong password")
    unit.disk.password = number


def _parse_network(rest: str) -> tuple[str, str]:
    address, _, mask = text_after_colon(rest).partition("*")
    mask = mask.strip() or _MASK
    try:
        ipaddress.IPv4Network(f"0.0.0.0/{mask}")
        return str(ipaddress.IPv4Address(address.strip())), mask
    except ValueError:
        raise InputRefused("not an address") from None


def _execute_changeip(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    unit.disk.address, unit.disk.mask = _parse_network(rest)


def _execute_changeip_eib(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    unit.disk.eib_address, unit.disk.eib_mask = _parse_network(rest)


def _execute_reset_eib(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """reset_eib: the counters of the device start at zero (L5037)."""
    del client
    require_end(rest)
    for axis in unit.machine.axes:
        if axis.encoder is not None:
            axis.encoder.load_counter(0, axis.steps - axis.origin)


# Panel


def _execute_page(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    require_end(rest)
    if len(unit.machine.axes) <= 8:
        raise InputRefused("only with more than eight axes")
    unit.second_page = not unit.second_page


# Control COM port


def _execute_cc_open(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    require_end(rest)
    unit.com.open = True


def _execute_cc_close(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    require_end(rest)
    unit.com.open = False


def _execute_cc_write(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    text = text_after_colon(rest)
    if "*" in text:
        raise InputRefused("'*' is not allowed")
    if not unit.com.open:
        raise InputRefused("COM port not open")
    unit.com.write_text(text.replace(",", "."))


def _execute_cc_read(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    require_end(rest)
    if not unit.com.open:
        raise InputRefused("COM port not open")
    unit.com.read, unit.com.received = unit.com.received, ""


# File based write filter


def _filter_handler(*, on: bool) -> Handler:
    def set_filter(unit: ControlProgram, client: CommandClient, rest: str) -> None:
        del client
        require_end(rest)
        unit.disk.filter_next = on

    return set_filter


def _execute_fbwf_configure(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    require_end(rest)
    unit.disk.filter_spares_files = True


def _execute_fbwf_status(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    require_end(rest)
    client.send_reply(f"FBWF {'enabled' if unit.disk.filtered else 'disabled'}")


SYSTEM: Commands = {
    "block": CommandEntry(_execute_block, CommandUsage.ALWAYS, "cancel positioning tasks and block communication"),
    "cc_close": CommandEntry(_execute_cc_close, CommandUsage.IDLE, "close control com port"),
    "cc_open": CommandEntry(_execute_cc_open, CommandUsage.IDLE, "open control com port"),
    "cc_read": CommandEntry(_execute_cc_read, CommandUsage.IDLE, "read from control com port"),
    "cc_write": CommandEntry(_execute_cc_write, CommandUsage.IDLE, "write to control com port"),
    "ccnt": CommandEntry(_execute_ccnt, CommandUsage.IDLE, "clear counter memory", needs="counter"),
    "ccount": CommandEntry(_execute_ccount, CommandUsage.IDLE, "start continuous counting", needs="counter"),
    "cerr": CommandEntry(_execute_cerr, CommandUsage.IDLE, "clear error"),
    "changeip": CommandEntry(_execute_changeip, CommandUsage.IDLE, "change IP address"),
    "changeip_eib": CommandEntry(_execute_changeip_eib, CommandUsage.IDLE, "change EIB7 IP address", needs="eib7"),
    "clr": CommandEntry(_execute_clr, CommandUsage.IDLE, "clear program memory"),
    "count": CommandEntry(_execute_count, CommandUsage.IDLE, "start single count interval", needs="counter"),
    "date": CommandEntry(_execute_date, CommandUsage.ALWAYS, "set system date"),
    "dfi": CommandEntry(_execute_dfi, CommandUsage.IDLE, "set filter", needs="filter", names=("dfl",)),
    "dhs": CommandEntry(_execute_dhs, CommandUsage.IDLE, "set half screen", needs="half_screen"),
    "doff": CommandEntry(
        _switch_handler("display", value=False), CommandUsage.ALWAYS, "deactivate position display", names=("lcdoff",)
    ),
    "don": CommandEntry(
        _switch_handler("display", value=True), CommandUsage.ALWAYS, "activate position display", names=("lcdon",)
    ),
    "dout": CommandEntry(_execute_dout, CommandUsage.ALWAYS, "set i/o-port output", needs="io_port", names=("io",)),
    "echo": CommandEntry(_flag_handler("echo", 0, 2), CommandUsage.ALWAYS, "set status message level"),
    "fbwf_configure": CommandEntry(_execute_fbwf_configure, CommandUsage.IDLE, "configure FBWF", needs="fbwf"),
    "fbwf_disable": CommandEntry(_filter_handler(on=False), CommandUsage.IDLE, "disable FBWF", needs="fbwf"),
    "fbwf_enable": CommandEntry(_filter_handler(on=True), CommandUsage.IDLE, "enable FBWF", needs="fbwf"),
    "fbwf_status": CommandEntry(_execute_fbwf_status, CommandUsage.IDLE, "query FBWF status", needs="fbwf"),
    "fdelete": CommandEntry(_execute_fdelete, CommandUsage.IDLE, "delete file"),
    "fget": CommandEntry(_execute_fget, CommandUsage.IDLE, "transfer file"),
    "fwrite": CommandEntry(_execute_fwrite, CommandUsage.IDLE, "write parameter to file"),
    "iel": CommandEntry(_execute_iel, CommandUsage.IDLE, "ignore active limit switch"),
    "list": CommandEntry(_execute_list, CommandUsage.IDLE, "returns a list of available user programs"),
    "load": CommandEntry(_execute_load, CommandUsage.IDLE, "load program from harddisk"),
    "local": CommandEntry(
        _switch_handler("local", value=True), CommandUsage.ALWAYS, "activate LOCAL mode", names=("loc",)
    ),
    "passwd": CommandEntry(_execute_passwd, CommandUsage.NOT_PROGRAM, "set administrator password"),
    "pg": CommandEntry(_execute_page, CommandUsage.ALWAYS, "switch to position display of axes 9-16"),
    "priority": CommandEntry(
        _flag_handler("priority", 0, 3), CommandUsage.ALWAYS, "set execution priority", names=("prio", "pri")
    ),
    "reboot": CommandEntry(_restart_handler(RestartKind.REBOOT), CommandUsage.ALWAYS, "restart controller"),
    "remote": CommandEntry(
        _switch_handler("local", value=False), CommandUsage.ALWAYS, "activate REMOTE mode", names=("rem",)
    ),
    "reset": CommandEntry(
        _restart_handler(RestartKind.RESET), CommandUsage.ALWAYS, "reset controller to power-on state", names=("clear",)
    ),
    "reset_eib": CommandEntry(_execute_reset_eib, CommandUsage.IDLE, "reset an EIB7", needs="eib7"),
    "restart": CommandEntry(_restart_handler(RestartKind.REBOOT), CommandUsage.ALWAYS, "restart control program"),
    "save": CommandEntry(_execute_save, CommandUsage.IDLE, "save program to disk"),
    "shutdown": CommandEntry(
        _restart_handler(RestartKind.SHUTDOWN), CommandUsage.ALWAYS, "shutdown controller", names=("off",)
    ),
    "sleep": CommandEntry(_execute_sleep, CommandUsage.ALWAYS, "delay command execution"),
    "sound": CommandEntry(_flag_handler("sound", 0, 1), CommandUsage.ALWAYS, "activate/deactivate acoustic signals"),
    "start": CommandEntry(_execute_start, CommandUsage.IDLE, "start program execution"),
    "time": CommandEntry(_execute_time, CommandUsage.ALWAYS, "set system time"),
    "txdel": CommandEntry(_flag_handler("txdel", 0, 3), CommandUsage.IDLE, "set delimiter for data transmission"),
    "txp": CommandEntry(_flag_handler("stx", 0, 1), CommandUsage.IDLE, "enable communication with STX/ETX"),
    "unblock": CommandEntry(
        _switch_handler("blocked", value=False),
        CommandUsage.ALWAYS,
        "resume communication",
        names=("unlock",),
        blocked=True,
    ),
    "us": CommandEntry(_execute_us, CommandUsage.ALWAYS, "set user status"),
}
"""Other direct commands by name. restart is the alias of reboot, allowed during motion (L1377, L2594)."""
