"""Configuration commands (section 12.1), and those that save and switch configurations."""

from sim.ppsmc.grammar import Refused, after_colon, integer, leading_axis
from sim.ppsmc.registry import Command, Commands, When
from sim.ppsmc.settings import ALIASES, ALTERNATIVE, READERS, configure
from sim.ppsmc.unit import Client, Handler, Unit

_BOARD_ONLY = ("ect", "est")
"""Only with the PCI board (L512, L707)."""

_HELP = {
    "acc": "acceleration ramp",
    "alias": "axis alias",
    "bln": "set backlash loop distance for [-] referencing",
    "blp": "set backlash loop distance for [+] referencing",
    "cf": "encoder calibration factor",
    "conf": "hardware definition",
    "dcpl": "set number of decimal places",
    "dec": "deceleration ramp",
    "ecl": "enable closed loop positioning (encoder)",
    "ect": "define encoder counter type",
    "edev": "closed loop positioning target window",
    "edir": "encoder rotation sense",
    "emips": "enable motion depending on input port status",
    "eres": "encoder resolution",
    "esh": "enable encoder position display",
    "esm": "encoder signal multiplication factor",
    "est": "encoder signal type",
    "ffast": "manual positioning speed",
    "fn": "display additional axis label",
    "frun": "manual start-stop speed",
    "gden": "gear reduction factor denominator",
    "gnum": "gear reduction factor numerator",
    "hsdm": "slow-down mode of homing procedure",
    "macc": "acceleration ramp for manual positioning",
    "mdec": "deceleration ramp for manual positioning",
    "mdir": "motor rotation sense",
    "mpr": "max. number of positioning retries",
    "prst": "retry delay for encoder closed-loop operation",
    "prt": "max. deviation for positioning retries",
    "rofs": "reference position offset",
    "sdm": "slow-down signal mode for homing procedure",
    "unit": "position display unit",
}


def _setter(name: str) -> Handler:
    def run(unit: Unit, client: Client, rest: str) -> None:
        del client
        number, rest = leading_axis(rest)
        axis = unit.machine.axis(number)
        text = after_colon(rest)
        if unit.modern and name == "alias" and "~" in text:
            text, _, full_name = text.partition("~")
            configure(axis.settings, "fn", full_name, unit.options.fmax_hz)
        configure(axis.settings, name, text, unit.options.fmax_hz)

    return run


def _pqrf(unit: Unit, client: Client, rest: str) -> None:
    del client
    unit.append_unit = bool(integer(rest.removeprefix(":"), 0, 1))


def _twen(unit: Unit, client: Client, rest: str) -> None:
    """The average of two encoders; an axis paired with itself is on its own again (L4571)."""
    del client
    number, rest = leading_axis(rest)
    axis = unit.machine.axis(number)
    second = integer(after_colon(rest), 1, len(unit.machine.axes))
    axis.settings.twen = 0 if second == axis.number else second


def _update(unit: Unit, client: Client, rest: str) -> None:
    del client
    configuration = integer(rest, 0, 1) if rest else 0
    saved = [axis.settings.copy() for axis in unit.machine.axes]
    if configuration:
        unit.disk.alternative = saved
    else:
        unit.disk.default = saved
        unit.disk.append_unit = unit.append_unit


def _chconf(unit: Unit, client: Client, rest: str) -> None:
    """Gear and speed profile of one axis or all from the default or the alternative configuration (L4491-L4526)."""
    del client
    number, rest = leading_axis(rest)
    text = after_colon(rest) if rest else ""
    alternative = integer(text, 0, 1) if text else 0
    axes = unit.machine.some(number)
    saved = unit.disk.alternative if alternative else unit.disk.default
    if saved is None:
        raise Refused("no alternative configuration")
    unit.apply(saved, ALTERNATIVE, axes)


def _second_names(name: str) -> tuple[str, ...]:
    return tuple(alias for alias, meant in ALIASES.items() if meant == name)


SETUP: Commands = {
    name: Command(
        _setter(name),
        When.IDLE,
        _HELP[name],
        needs="pc_board" if name in _BOARD_ONLY else None,
        names=_second_names(name),
    )
    for name in READERS
} | {
    "chconf": Command(_chconf, When.IDLE, "change configuration", needs="io_port"),
    "pqrf": Command(_pqrf, When.IDLE, "position query response format", names=("pqr", "pgrf")),
    "twen": Command(_twen, When.IDLE, "twin encoder"),
    "update": Command(_update, When.IDLE, "save configuration parameters"),
}
"""Configuration commands by name."""
