"""Memory switches: nine items of numbered contents (L7367-L7375).

The manual names the contents of GENERAL and one of SPEED; the others are in its other volume, so the numbering of the
rest is this simulator's, and contents without a name here are stored and have no effect.
"""

import copy
from collections.abc import Sequence

from sim.shrc203.grammar import MAX_PULSES, MAX_RAMP_MS, MAX_SPEED, CommandRefused, parse_division, parse_integer
from sim.shrc203.options import Shrc203Options
from sim.shrc203.path import SpeedTriple

GENERAL, INTERFACE, SENSOR, AXIS, MOTOR_DRIVER, SPEED, ORG, FEEDBACK, SOFT_LIMIT = range(9)

AXIS_CODES: tuple[tuple[int, ...], ...] = ((1,), (2,), (3,), (1, 2), (1, 3), (2, 3), (1, 2, 3))
"""Controllable axes by the code of GENERAL-AXIS and ?:AXIS (L2206-L2222)."""
STAGE_UNITS = "PNUMD"
CONFIGS = ("off", "ok", "error", "missing")

G_AXIS, G_MODE, G_SLEEP, G_BEEP, G_JOG_X, G_JOG_Y, G_FORMAT, G_TRG_LEVEL, G_TRG_WIDTH = range(9)
_GENERAL_TOP = (6, 1, 1, 1, 2, 2, 1, 1, 9)
_INTERFACE_SIZE, _SENSOR_SIZE = 4, 6
A_NAME, A_BASE_RATE, A_CONFIG, A_EMERGENCY, A_UNIT = 0, 3, 6, 9, 12
_ORG_SIZE, ORG_METHOD, ORG_SPEEDS = 18, 0, 9
_SPEED_TOP = (MAX_SPEED, MAX_SPEED, MAX_RAMP_MS)

_RESTARTING = (INTERFACE, SENSOR, AXIS, MOTOR_DRIVER, FEEDBACK, SOFT_LIMIT)

Items = list[list[str]]


def _build_contents(options: Shrc203Options) -> Items:
    """Return the contents of all items for a controller with these options."""
    soft: list[str] = []
    for key in ("1", "2", "3"):
        low, high = options.soft_limit_pls.get(key, (-MAX_PULSES, MAX_PULSES))
        soft += [str(int(key in options.soft_limit_pls)), str(low), str(high)]
    speed = [str(value) for value in options.speed]
    origin = [str(value) for value in options.origin_speed]
    emergency = str(int(not options.emergency_excitation_off))
    names = list(options.axis_names)
    configs = [str(int(config != "off")) for config in options.config]
    return [
        [str(AXIS_CODES.index(tuple(options.controllable))), "0", "1", "1", "0", "1", "0", "0", "0"],
        ["0"] * _INTERFACE_SIZE,
        ["0"] * _SENSOR_SIZE,
        [*names, *map(str, options.base_rates()), *configs, *[emergency] * 3, *["0"] * 3],
        [str(options.divide)] * 3,
        ["1", *speed * 12],
        [*["3"] * 3, *["0"] * 6, *origin * 3],
        ["1"] * 3,
        soft,
    ]


class MemorySwitches:
    """The saved settings, and the copy that is edited between MS:ON and MS:OFF."""

    def __init__(self, options: Shrc203Options) -> None:
        self._saved = _build_contents(options)
        self._defaults = _build_contents(Shrc203Options(scales=options.scales))
        self._edited = copy.deepcopy(self._saved)

    # Editing

    def begin_edit(self) -> None:
        self._edited = copy.deepcopy(self._saved)

    def save_edited(self) -> bool:
        """MS:OFF (L7342). Return True when a change makes the controller restart by itself."""
        old_switches, self._saved = self._saved, copy.deepcopy(self._edited)
        general = any(old_switches[GENERAL][n] != self._saved[GENERAL][n] for n in (G_AXIS, G_FORMAT))
        return general or any(old_switches[item] != self._saved[item] for item in _RESTARTING)

    def put_content(self, item: int, content: int, text: str) -> None:
        self._edited[item][content] = _check_content(item, content, text)

    def put_item(self, item: int, texts: Sequence[str]) -> None:
        if len(texts) != len(self._edited[item]):
            raise CommandRefused
        self._edited[item] = [_check_content(item, content, text) for content, text in enumerate(texts)]

    def restore_content(self, item: int, content: int) -> None:
        self._edited[item][content] = self._defaults[item][content]

    def restore_item(self, item: int) -> None:
        self._edited[item] = list(self._defaults[item])

    def edited_texts(self, item: int) -> list[str]:
        return self._edited[item]

    def default_texts(self, item: int) -> list[str]:
        return self._defaults[item]

    # Values in use

    def general_value(self, content: int) -> int:
        return int(self._saved[GENERAL][content])

    def controllable_axes(self) -> tuple[int, ...]:
        return AXIS_CODES[self.general_value(G_AXIS)]

    def axis_content(self, content: int, index: int) -> str:
        """Return content of item AXIS, `A_…`, of the axis with this index."""
        return self._saved[AXIS][content + index]

    def division_number(self, index: int) -> int:
        return int(self._saved[MOTOR_DRIVER][index])

    def power_up_speed(self, index: int) -> SpeedTriple:
        """Return the triple chosen by SPEED SEL (L4902)."""
        return self.speed_triple(index, int(self._saved[SPEED][0]))

    def speed_triple(self, index: int, number: int) -> SpeedTriple:
        """Return speed number 1-4 of an axis. Content 4 is SPEED12 (S): axis 1, number 2 (L7392)."""
        at = 1 + 3 * (4 * index + number - 1)
        s, f, r = self._saved[SPEED][at : at + 3]
        return SpeedTriple(int(s), int(f), int(r))

    def origin_speed(self, index: int) -> SpeedTriple:
        at = ORG_SPEEDS + 3 * index
        s, f, r = self._saved[ORG][at : at + 3]
        return SpeedTriple(int(s), int(f), int(r))

    def closed_loop(self, index: int) -> bool:
        return self._saved[FEEDBACK][index] == "0"

    def soft_limits(self, index: int) -> tuple[int, int] | None:
        switch, low, high = self._saved[SOFT_LIMIT][3 * index : 3 * index + 3]
        return (int(low), int(high)) if switch == "1" else None


def _check_content(item: int, content: int, text: str) -> str:
    """Return `text` in read-back form if content `content` of `item` can have that value."""
    if item == AXIS and A_NAME <= content < A_BASE_RATE:
        if len(text) == 1 and (text in "123456789" or "A" <= text <= "Z"):
            return text
        raise CommandRefused
    if item == MOTOR_DRIVER:
        return str(parse_division(text))
    low, high = _content_bounds(item, content)
    return str(parse_integer(text, low, high))


def _content_bounds(item: int, content: int) -> tuple[int, int]:
    if item == GENERAL:
        return 0, _GENERAL_TOP[content]
    if item == AXIS:
        return ((0, 0), (1, MAX_SPEED), (0, 1), (0, 1), (0, len(STAGE_UNITS) - 1))[content // 3]
    if item == SPEED:
        return (1, 4) if content == 0 else (1, _SPEED_TOP[(content - 1) % 3])
    if item == ORG and content < 3:
        return 0, 4
    if item == ORG and content >= ORG_SPEEDS:
        return 1, _SPEED_TOP[(content - ORG_SPEEDS) % 3]
    if item == FEEDBACK:
        return 0, 1
    if item == SOFT_LIMIT:
        return (0, 1) if content % 3 == 0 else (-MAX_PULSES, MAX_PULSES)
    return 0, 999_999
