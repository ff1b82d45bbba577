"""Query commands (section 12.4): what they answer, and in which form."""

from collections.abc import Callable

from sim.ppsmc.axis import Axis
from sim.ppsmc.grammar import integer, leading_axis, nothing, plain
from sim.ppsmc.registry import Command, Commands, When
from sim.ppsmc.sensors import Switch
from sim.ppsmc.settings import NAMES
from sim.ppsmc.task import Kind
from sim.ppsmc.unit import Client, Handler, Unit

_DLL = "smc.dll 1.1.165"


def _asked(unit: Unit, rest: str) -> list[Axis]:
    number, rest = leading_axis(rest)
    nothing(rest)
    return unit.machine.some(number)


def _oscillates(axis: Axis) -> bool:
    return axis.task is not None and axis.task.kind is Kind.OSCILLATION


def _position(unit: Unit, axis: Axis) -> str:
    """The position as ?p gives it, without its unit (L4226-L4230)."""
    if _oscillates(axis):
        return "osc"
    distance = axis.distance(unit.machine.drive.counter(axis))
    return plain(distance, axis.settings.dcpl, unit.options.trailing_zeros)


def _encoder(unit: Unit, axis: Axis) -> str:
    return plain(unit.machine.measured(axis), axis.settings.dcpl, unit.options.trailing_zeros)


def _status_bits(unit: Unit, axis: Axis) -> int:
    """The mask of ?s (L4296-L4308, L1406)."""
    machine = unit.machine
    bits = (
        (0, axis.task is None),
        (1, axis.referenced),
        (2, machine.limit_on(axis, Switch.EL_MINUS)),
        (3, machine.limit_on(axis, Switch.EL_PLUS)),
        (4, unit.modern and axis.homed),
        (6, unit.runner.running),
        (7, unit.idle),
        (8, _oscillates(axis)),
        (9, axis.oscillation_error),
        (10, axis.index_found),
        (14, unit.blocked),
        (15, unit.modern and axis.error[0] != 0),
    )
    return sum(1 << bit for bit, on in bits if on)


def _per_axis(value: Callable[[Unit, Axis], str]) -> Handler:
    """A query of one line, `<axis>:<value>;` for one axis or all."""

    def run(unit: Unit, client: Client, rest: str) -> None:
        client.say("".join(f"{axis.number}:{value(unit, axis)};" for axis in _asked(unit, rest)))

    return run


def _with_unit(unit: Unit, axis: Axis) -> str:
    text = _position(unit, axis)
    return text + axis.settings.unit if unit.append_unit and text != "osc" else text


def _plain(value: Callable[[Unit], str]) -> Handler:
    """A query without argument, of one line."""

    def run(unit: Unit, client: Client, rest: str) -> None:
        nothing(rest)
        client.say(value(unit))

    return run


def _status(unit: Unit, client: Client, rest: str) -> None:
    """One line an axis, and an empty one (decision 7); later firmware has 17 fields."""
    machine = unit.machine
    long = unit.modern if unit.options.long_status is None else unit.options.long_status
    for axis in _asked(unit, rest):
        limits = machine.limit_on(axis, Switch.EL_MINUS) + 2 * machine.limit_on(axis, Switch.EL_PLUS)
        fields: list[object] = [axis.number, *axis.error, _position(unit, axis), _encoder(unit, axis), limits]
        fields += [int(axis.referenced), int(axis.index_found), int(unit.idle), int(_oscillates(axis))]
        if long:
            fields += [int(axis.oscillation_error), int(axis.task is not None), int(unit.runner.running)]
            fields += [axis.settings.conf, 0, int(unit.blocked), 0]
        else:
            fields.append(int(unit.runner.running))
        client.say(":".join(map(str, fields)))
    client.say("")


def _err(unit: Unit, client: Client, rest: str) -> None:
    """One line an axis (decision 9)."""
    for axis in _asked(unit, rest):
        number, text = axis.error
        client.say(f"{axis.number}:{number} {text}".rstrip())


def _target(axis: Axis) -> str:
    """One entry of the target buffer (decision 10)."""
    if axis.target is None:
        return "r0"
    absolute, distance = axis.target
    return ("a" if absolute else "r") + plain(distance, axis.settings.dcpl)


def _conf(unit: Unit, client: Client, rest: str) -> None:
    """A block of lines an axis, sorted by name, with an empty line between blocks (decision 8)."""
    for index, axis in enumerate(_asked(unit, rest)):
        if index:
            client.say("")
        client.say(f"# configuration settings of axis {axis.number}")
        values = {name: axis.settings.written(name) for name in NAMES}
        values["type"] = values["conf"]
        for name in sorted(values):
            client.say(f"{name}{axis.number}:{values[name]}")


def _listing(unit: Unit, client: Client, rest: str) -> None:
    nothing(rest)
    for text in unit.memory.listing or [""]:
        client.say(text)


def _counts(unit: Unit, client: Client, rest: str) -> None:
    """The counts one by one; an empty memory is one empty line."""
    nothing(rest)
    for text in [str(count) for count in unit.counter.memory] or [""]:
        client.say(text)


def _eib(unit: Unit, client: Client, rest: str) -> None:
    """What an EIB7 tells about itself (L4946-L4966)."""
    nothing(rest)
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
        client.say(line)


def _eib_axis(unit: Unit, client: Client, rest: str) -> None:
    """Counter state of an axis on an EIB7, which has four inputs (L5014-L5017)."""
    number = integer(rest, 1, len(unit.machine.axes))
    axis = unit.machine.axis(number)
    client.say(f"Heidenhain EIB7 input X1{(number - 1) % 4 + 1}")
    client.say(f"position: {axis.increments(unit.machine.drive.exact(axis)[0])}")
    client.say("status: ok")


def _setting(name: str) -> Handler:
    """Later firmware answers `?<parameter><axis>` with a configuration line."""

    def run(unit: Unit, client: Client, rest: str) -> None:
        for axis in _asked(unit, rest):
            client.say(f"{name}{axis.number}:{axis.settings.written(name)}")

    return run


_LATER: Commands = {
    f"?{name}": Command(_setting(name), When.ALWAYS, f"get {name}", later=True) for name in NAMES if name != "conf"
}

QUERIES: Commands = _LATER | {
    "?a": Command(_plain(lambda unit: str(len(unit.machine.axes))), When.ALWAYS, "get number of axes", later=True),
    "?c": Command(_plain(lambda unit: str(unit.counter.last)), When.IDLE, "get last counter value", needs="counter"),
    "?ccb": Command(_plain(lambda unit: unit.com.read), When.IDLE, "get control COM input buffer"),
    "?cnt": Command(_counts, When.IDLE, "get counter memory", needs="counter"),
    "?conf": Command(_conf, When.IDLE, "get current configuration settings", names=("?cfg",)),
    "?dll": Command(_plain(lambda unit: _DLL), When.ALWAYS, "get control DLL version"),
    "?e": Command(_per_axis(_encoder), When.ALWAYS, "get current encoder position"),
    "?ec": Command(
        _per_axis(lambda unit, axis: str(axis.increments(unit.machine.drive.exact(axis)[0]))),
        When.ALWAYS,
        "get current encoder counter value",
    ),
    "?err": Command(_err, When.ALWAYS, "get last error"),
    "?i_eib": Command(_eib, When.IDLE, "query information about the connected EIB7", needs="eib7"),
    "?in": Command(
        _plain(lambda unit: str(unit.machine.inputs)),
        When.ALWAYS,
        "get input port status",
        needs="io_port",
        names=("?io",),
    ),
    "?ip": Command(_plain(lambda unit: unit.disk.address), When.ALWAYS, "get IP address"),
    "?ip_eib": Command(_plain(lambda unit: unit.disk.eib_address), When.IDLE, "query EIB7 IP address", needs="eib7"),
    "?line": Command(
        _plain(lambda unit: str(unit.runner.line)), When.ALWAYS, "get current line number", names=("?ln", "?lin")
    ),
    "?out": Command(
        _plain(lambda unit: str(unit.machine.outputs)), When.ALWAYS, "get output port status", needs="io_port"
    ),
    "?p": Command(_per_axis(_with_unit), When.ALWAYS, "get current position", blocked=True),
    "?pgm": Command(_listing, When.IDLE, "get program memory content", names=("?getp",)),
    "?s": Command(
        _per_axis(lambda unit, axis: str(_status_bits(unit, axis))),
        When.ALWAYS,
        "get status information",
        blocked=True,
    ),
    "?s_eib": Command(_eib_axis, When.IDLE, "query EIB7 status", needs="eib7"),
    "?status": Command(_status, When.ALWAYS, "get detailed status information"),
    "?tb": Command(
        _plain(lambda unit: "".join(f"{axis.number}:{_target(axis)};" for axis in unit.machine.axes)),
        When.ALWAYS,
        "get target buffer content",
    ),
    "?us": Command(_plain(lambda unit: str(unit.user_status)), When.ALWAYS, "get user status"),
    "?v": Command(
        _plain(lambda unit: unit.version), When.ALWAYS, "get id and control program version", names=("*idn?",)
    ),
}
"""Queries by name, `?` itself excepted."""
