"""Configuration commands (section 12.1), and those that save and switch configurations."""

from sim.ppsmc.grammar import InputRefused, parse_integer, split_axis, text_after_colon
from sim.ppsmc.registry import CommandEntry, Commands, CommandUsage
from sim.ppsmc.settings import ALIASES, ALTERNATIVE, READERS, set_parameter
from sim.ppsmc.unit import CommandClient, ControlProgram, Handler

_BOARD_ONLY = ("ect", "est")
"""Available only with the PCI board (L512, L707)."""

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


def _setting_handler(name: str) -> Handler:
    def apply_setting(unit: ControlProgram, client: CommandClient, rest: str) -> None:
        del client
        number, rest = split_axis(rest)
        axis = unit.machine.find_axis(number)
        text = text_after_colon(rest)
        if unit.is_modern and name == "alias" and "~" in text:
            text, _, full_name = text.partition("~")
            set_parameter(axis.settings, "fn", full_name, unit.options.fmax_hz)
        set_parameter(axis.settings, name, text, unit.options.fmax_hz)

    return apply_setting


def _execute_pqrf(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    unit.append_unit = bool(parse_integer(rest.removeprefix(":"), 0, 1))


def _execute_twen(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """twen: the average of two encoders; an axis paired with itself is single again (L4571)."""
    del client
    number, rest = split_axis(rest)
    axis = unit.machine.find_axis(number)
    second = parse_integer(text_after_colon(rest), 1, len(unit.machine.axes))
    axis.settings.twen = 0 if second == axis.number else second


def _execute_update(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    del client
    configuration = parse_integer(rest, 0, 1) if rest else 0
    saved_settings = [axis.settings.copy_settings() for axis in unit.machine.axes]
    if configuration:
        unit.disk.alternative = saved_settings
    else:
        unit.disk.default = saved_settings
        unit.disk.append_unit = unit.append_unit


def _execute_chconf(unit: ControlProgram, client: CommandClient, rest: str) -> None:
    """chconf: load gear and speed profile of one axis or all from the default or the alternative configuration
    (L4491-L4526)."""
    del client
    number, rest = split_axis(rest)
    text = text_after_colon(rest) if rest else ""
    alternative = parse_integer(text, 0, 1) if text else 0
    axes = unit.machine.select_axes(number)
    saved_settings = unit.disk.alternative if alternative else unit.disk.default
    if saved_settings is None:
        raise InputRefused("no alternative configuration")
    unit.apply_settings(saved_settings, ALTERNATIVE, axes)


def _alias_names(name: str) -> tuple[str, ...]:
    return tuple(alias for alias, target in ALIASES.items() if target == name)


SETUP: Commands = {
    name: CommandEntry(
        _setting_handler(name),
        CommandUsage.IDLE,
        _HELP[name],
        needs="pc_board" if name in _BOARD_ONLY else None,
        names=_alias_names(name),
    )
    for name in READERS
} | {
    "chconf": CommandEntry(_execute_chconf, CommandUsage.IDLE, "change configuration", needs="io_port"),
    "pqrf": CommandEntry(_execute_pqrf, CommandUsage.IDLE, "position query response format", names=("pqr", "pgrf")),
    "twen": CommandEntry(_execute_twen, CommandUsage.IDLE, "twin encoder"),
    "update": CommandEntry(_execute_update, CommandUsage.IDLE, "save configuration parameters"),
}
"""Configuration commands by name."""
