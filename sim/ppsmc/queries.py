"""Query commands (section 12.4): their answers and formats."""

from collections.abc import Callable

from sim.ppsmc.axis import StepperAxis
from sim.ppsmc.grammar import format_decimal, parse_integer, require_end, split_axis
from sim.ppsmc.legs import TaskKind
from sim.ppsmc.registry import CommandEntry, Commands, CommandUsage
from sim.ppsmc.sensors import TravelSwitch
from sim.ppsmc.settings import NAMES
from sim.ppsmc.unit import CommandClient, ControlProgram, Handler

_DLL = "smc.dll 1.1.165"


def _queried_axes(unit: ControlProgram, rest: str) -> list[StepperAxis]:
    number, rest = split_axis(rest)
    require_end(rest)
    return unit.machine.select_axes(number)


def _is_oscillating(axis: StepperAxis) -> bool:
    return axis.task is not None and axis.task.kind is TaskKind.OSCILLATION


def _format_position(unit: ControlProgram, axis: StepperAxis) -> str:
    """Format the position as ?p gives it, without its unit (L4226-L4230)."""
    if _is_oscillating(axis):
        return "osc"
    distance = axis.steps_to_distance(unit.machine.drive.step_counter(axis))
    return format_decimal(distance, axis.settings.dcpl, zeros=unit.options.trailing_zeros)


def _format_encoder(unit: ControlProgram, axis: StepperAxis) -> str:
    return format_decimal(unit.machine.measured_position(axis), axis.settings.dcpl, zeros=unit.options.trailing_zeros)


def _status_bits(unit: ControlProgram, axis: StepperAxis) -> int:
    """Return the mask of ?s (L4296-L4308, L1406)."""
    machine = unit.machine
    bits = (
        (0, axis.task is None),
        (1, axis.referenced),
        (2, machine.is_limit_on(axis, TravelSwitch.EL_MINUS)),
        (3, machine.is_limit_on(axis, TravelSwitch.EL_PLUS)),
        (4, unit.is_modern and axis.homed),
        (6, unit.runner.is_running),
        (7, unit.is_idle),
        (8, _is_oscillating(axis)),
        (9, axis.oscillation_error),
        (10, axis.index_found),
        (14, unit.blocked),
        (15, unit.is_modern and axis.error[0] != 0),
    )
    return sum(1 << bit for bit, on in bits if on)


def _axis_query(value: Callable[[ControlProgram, StepperAxis], str]) -> Handler:
    """Make a query of one line, `<axis>:<value>;` for one axis or all."""

    def answer_axes(unit: ControlProgram, client: CommandClient, rest: str) -> None:
        client.send_reply("".join(f"{axis.number}:{value(unit, axis)};" for axis in _queried_axes(unit, rest)))

    return answer_axes


def _format_with_unit(unit: ControlProgram, axis: StepperAxis) -> str:
    text = _format_position(unit, axis)
    return text + axis.settings.unit if unit.append_unit and text != "osc" else text


def _plain_query(value: Callable[[ControlProgram], str]) -> Handler:
    """Make a query without argument, of one line."""

    def answer_value(unit: ControlProgram, client: CommandClient, rest: str) -> None:
        require_end(rest)
        client.send_reply(value(unit))

    return answer_value


def _answer_status(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """?status: one line per axis, and an empty one (decision 7); later firmware has 17 fields."""
    machine = unit.machine
    long = unit.is_modern if unit.options.long_status is None else unit.options.long_status
    for axis in _queried_axes(unit, rest):
        limits = machine.is_limit_on(axis, TravelSwitch.EL_MINUS) + 2 * machine.is_limit_on(axis, TravelSwitch.EL_PLUS)
        fields: list[object] = [
            axis.number,
            *axis.error,
            _format_position(unit, axis),
            _format_encoder(unit, axis),
            limits,
        ]
        fields += [int(axis.referenced), int(axis.index_found), int(unit.is_idle), int(_is_oscillating(axis))]
        if long:
            fields += [int(axis.oscillation_error), int(axis.task is not None), int(unit.runner.is_running)]
            fields += [axis.settings.conf, 0, int(unit.blocked), 0]
        else:
            fields.append(int(unit.runner.is_running))
        client.send_reply(":".join(map(str, fields)))
    client.send_reply("")


def _answer_err(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """?err: one line per axis (decision 9)."""
    for axis in _queried_axes(unit, rest):
        number, text = axis.error
        client.send_reply(f"{axis.number}:{number} {text}".rstrip())


def _format_target(axis: StepperAxis) -> str:
    """Format one entry of the target buffer (decision 10)."""
    if axis.target is None:
        return "r0"
    absolute, distance = axis.target
    return ("a" if absolute else "r") + format_decimal(distance, axis.settings.dcpl)


def _answer_conf(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """?conf: a block of lines per axis, sorted by name, with an empty line between blocks (decision 8)."""
    for index, axis in enumerate(_queried_axes(unit, rest)):
        if index:
            client.send_reply("")
        client.send_reply(f"# configuration settings of axis {axis.number}")
        values = {name: axis.settings.format_value(name) for name in NAMES}
        values["type"] = values["conf"]
        for name in sorted(values):
            client.send_reply(f"{name}{axis.number}:{values[name]}")


def _answer_listing(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    require_end(rest)
    for text in unit.memory.list_commands or [""]:
        client.send_reply(text)


def _answer_counts(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """?cnt: the counts one by one; an empty memory is one empty line."""
    require_end(rest)
    for text in [str(count) for count in unit.counter.memory] or [""]:
        client.send_reply(text)


def _answer_eib(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """Report the identification of an EIB7 (L4946-L4966)."""
    require_end(rest)
    for line in (
        "id: 633281-01",
        f"IP-address: {unit.disk.eib_address}",
        f"netmask: {unit.disk.eib_mask}",
        "gateway: 192.168.253.0",
        "DHCP: disabled",
        "hostname: EIB741-33472242",
        "MAC: 00:A0:CD:10:00:EB",
        "bootmode: default firmware with user settings",
        "factory firmware version: 63328108",
        "user firmware version: 00000000",
    ):
        client.send_reply(line)


def _answer_eib_axis(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """Report the counter state of an axis on an EIB7, which has four inputs (L5014-L5017)."""
    number = parse_integer(rest, 1, len(unit.machine.axes))
    axis = unit.machine.find_axis(number)
    client.send_reply(f"Heidenhain EIB7 input X1{(number - 1) % 4 + 1}")
    client.send_reply(f"position: {axis.encoder_increments(unit.machine.drive.exact_state(axis)[0])}")
    client.send_reply("status: ok")


def _setting_query(name: str) -> Handler:
    """Answer `?<parameter><axis>` with a configuration line (later firmware)."""

    def answer_setting(unit: ControlProgram, client: CommandClient, rest: str) -> None:
        for axis in _queried_axes(unit, rest):
            client.send_reply(f"{name}{axis.number}:{axis.settings.format_value(name)}")

    return answer_setting


_LATER: Commands = {
    f"?{name}": CommandEntry(_setting_query(name), CommandUsage.ALWAYS, f"get {name}", later=True)
    for name in NAMES
    if name != "conf"
}

QUERIES: Commands = _LATER | {
    "?a": CommandEntry(
        _plain_query(lambda unit: str(len(unit.machine.axes))), CommandUsage.ALWAYS, "get number of axes", later=True
    ),
    "?c": CommandEntry(
        _plain_query(lambda unit: str(unit.counter.last)), CommandUsage.IDLE, "get last counter value", needs="counter"
    ),
    "?ccb": CommandEntry(_plain_query(lambda unit: unit.com.read), CommandUsage.IDLE, "get control COM input buffer"),
    "?cnt": CommandEntry(_answer_counts, CommandUsage.IDLE, "get counter memory", needs="counter"),
    "?conf": CommandEntry(_answer_conf, CommandUsage.IDLE, "get current configuration settings", names=("?cfg",)),
    "?dll": CommandEntry(_plain_query(lambda unit: _DLL), CommandUsage.ALWAYS, "get control DLL version"),
    "?e": CommandEntry(_axis_query(_format_encoder), CommandUsage.ALWAYS, "get current encoder position"),
    "?ec": CommandEntry(
        _axis_query(lambda unit, axis: str(axis.encoder_increments(unit.machine.drive.exact_state(axis)[0]))),
        CommandUsage.ALWAYS,
        "get current encoder counter value",
    ),
    "?err": CommandEntry(_answer_err, CommandUsage.ALWAYS, "get last error"),
    "?i_eib": CommandEntry(_answer_eib, CommandUsage.IDLE, "query information about the connected EIB7", needs="eib7"),
    "?in": CommandEntry(
        _plain_query(lambda unit: str(unit.machine.inputs)),
        CommandUsage.ALWAYS,
        "get input port status",
        needs="io_port",
        names=("?io",),
    ),
    "?ip": CommandEntry(_plain_query(lambda unit: unit.disk.address), CommandUsage.ALWAYS, "get IP address"),
    "?ip_eib": CommandEntry(
        _plain_query(lambda unit: unit.disk.eib_address), CommandUsage.IDLE, "query EIB7 IP address", needs="eib7"
    ),
    "?line": CommandEntry(
        _plain_query(lambda unit: str(unit.runner.line)),
        CommandUsage.ALWAYS,
        "get current line number",
        names=("?ln", "?lin"),
    ),
    "?out": CommandEntry(
        _plain_query(lambda unit: str(unit.machine.output_byte)),
        CommandUsage.ALWAYS,
        "get output port status",
        needs="io_port",
    ),
    "?p": CommandEntry(_axis_query(_format_with_unit), CommandUsage.ALWAYS, "get current position", blocked=True),
    "?pgm": CommandEntry(_answer_listing, CommandUsage.IDLE, "get program memory content", names=("?getp",)),
    "?s": CommandEntry(
        _axis_query(lambda unit, axis: str(_status_bits(unit, axis))),
        CommandUsage.ALWAYS,
        "get status information",
        blocked=True,
    ),
    "?s_eib": CommandEntry(_answer_eib_axis, CommandUsage.IDLE, "query EIB7 status", needs="eib7"),
    "?status": CommandEntry(_answer_status, CommandUsage.ALWAYS, "get detailed status information"),
    "?tb": CommandEntry(
        _plain_query(lambda unit: "".join(f"{axis.number}:{_format_target(axis)};" for axis in unit.machine.axes)),
        CommandUsage.ALWAYS,
        "get target buffer content",
    ),
    "?us": CommandEntry(_plain_query(lambda unit: str(unit.user_status)), CommandUsage.ALWAYS, "get user status"),
    "?v": CommandEntry(
        _plain_query(lambda unit: unit.firmware_version),
        CommandUsage.ALWAYS,
        "get id and control program version",
        names=("*idn?",),
    ),
}
"""Queries by name, `?` itself excepted."""
