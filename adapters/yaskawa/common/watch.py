"""The settings that motion relies on and that another client can change: read after connecting, and compared with what
the controller holds at rest and before each step.

A value that `configure` loads or accepts is the expected one. Coupling (GR, EB) and smoothing (IT) have only their
neutral values, except GR of the second motor of an axis. Line numbers are those of the SMC-4000's manual; the SMC-2000
has the same commands.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from adapters.contract import SettingDifference
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.shapes.model import LEAVE_CONTOUR
from adapters.yaskawa.wire.exchange import SmcCommandRefused
from adapters.yaskawa.wire.record import AXIS_LETTERS
from adapters.yaskawa.wire.session import pack_operands
from orchestrator.model.errors import ControllerFault

LABELS = "DL"  # number of free labels: another program has others
# Settings, and lines of the resident program, that one check at rest reads: a packet, and on a slow line 50 and 150
# characters, because stops wait for what is on the wire.
SETTINGS_AT_ONCE, SLOW_SETTINGS_AT_ONCE = 25, 3
LINES_AT_ONCE, SLOW_LINES_AT_ONCE = 10, 3
PROGRAM_TURN = 4  # on a slow line: every fourth part is of the program
# Op-codes of the settings that change where or when the next move goes; on a slow line, those that do so unnoticed.
SLOW_CRITICAL = frozenset(("TM", "EB", "IT", "GR"))
CRITICAL = SLOW_CRITICAL | {LABELS, "MT", "CE", "KS"}
ROUNDING = 2e-4  # of a fraction that is written as it was read, with four decimals


@dataclass(frozen=True, slots=True)
class WatchedSetting:
    """One setting, of each axis or of the controller.

    command: its op-code; the operand is `_` and this, and the letter of the axis.
    tolerance: by which a value may differ that was written as it was read.
    remedy: how a person corrects it, where a reset must not; `{value}` is the expected one.
    """

    command: str
    moves_reference: bool = False
    tolerance: float = ROUNDING
    remedy: str = ""


@dataclass(frozen=True, slots=True)
class WatchedSettings:
    """The settings of a model. controller: of the whole controller; axis: of each axis."""

    controller: tuple[WatchedSetting, ...]
    axis: tuple[WatchedSetting, ...]


_BY_HAND = "set it to {value} with the motor off (MO), then `tutti reset`"
_ALL_MODELS = (
    WatchedSetting("IT"),  # L6316
    WatchedSetting("GR"),  # L5535
    WatchedSetting("MT", moves_reference=True, remedy=_BY_HAND),  # L7678
    WatchedSetting("CE", moves_reference=True, remedy=_BY_HAND),  # L3490
    *(WatchedSetting(command) for command in ("FL", "BL", "ER", "OE", "TL", "KP", "KI", "KD", "FA", "FV")),
    *(WatchedSetting(command) for command in ("IL", "OF", "DV", "LT")),
)
_PERIOD = WatchedSetting(
    "TM", remedy="another sample period changes every speed: set it to {value}, then `tutti reset`"
)
_CAM = WatchedSetting("EB", moves_reference=True)  # L4417; positions are within a cycle (L13736)

SMC4000_WATCHED = WatchedSettings(
    controller=(
        _PERIOD,
        _CAM,
        *(WatchedSetting(f"CN{number}") for number in range(4)),  # L3700-3706
        WatchedSetting(LABELS),  # L4154
    ),
    axis=(
        *_ALL_MODELS,
        WatchedSetting("KS", tolerance=1 / 32),  # L6655; its default is between two of its steps
        WatchedSetting("GM"),  # L5488
        WatchedSetting("TK"),  # L10649
        WatchedSetting("NF"),  # L7871; NB and NZ have no effect while it is 0
        WatchedSetting("PL", tolerance=5e-3),  # the controller quantises it by an unstated rule (L8378-8387)
    ),
)
SMC2000_WATCHED = WatchedSettings(
    controller=(_PERIOD, _CAM, WatchedSetting(LABELS)),
    axis=(*_ALL_MODELS, WatchedSetting("AF", moves_reference=True, remedy=_BY_HAND)),
)


@dataclass(frozen=True, slots=True)
class _Item:
    """A setting of one axis, or of the controller (axis None)."""

    setting: WatchedSetting
    axis: str | None
    letter: str

    @property
    def operand(self) -> str:
        return f"_{self.setting.command}{self.letter}"

    def differs(self, found: float, expected: float) -> bool:
        """Return whether another client has changed the value; 0 means off, and is exact."""
        return found != expected if not expected else abs(found - expected) > self.setting.tolerance

    def to_difference(self, found: float, expected: float) -> SettingDifference:
        axis_text = f" of axis {self.axis}" if self.axis else ""
        remedy = self.setting.remedy.format(value=format_value(expected))
        return SettingDifference(
            item=f"{self.setting.command}{self.letter}{axis_text}",
            found=format_value(found),
            expected=format_value(expected),
            axis=self.axis,
            moves_reference=self.setting.moves_reference,
            repairable=not remedy,
            remedy=remedy,
        )


def format_value(value: float) -> str:
    """Format a value as the controller takes it: without an exponent."""
    return f"{value:.4f}".rstrip("0").rstrip(".")


class SettingsWatch:
    """The expected settings of one controller, and the differences from them.

    motors: axes, each with the index of a motor. slow: the time of the link is dominated by its characters; the
    critical settings are then read as sums of their deviations."""

    def __init__(
        self, device: SmcDevice, motors: Iterable[tuple[str, int]], watched: WatchedSettings, *, slow: bool = False
    ) -> None:
        self._device = device
        self._slow = slow
        self._items = _list_items(watched, motors)
        self._critical = self._select_critical(self._items)
        self._setting_parts: list[Sequence[_Item]] = []
        self._program_parts: list[range] = []
        self._expected: dict[str, float] = {}
        self._changed: set[str] = set()
        self._turn = 0
        self._program_differs = False

    @property
    def arm_operands(self) -> list[str]:
        """Return the operands that are read before a step."""
        return [item.operand for item in (self._critical if self._slow else self._items)]

    def expect_value(self, operand: str, value: float | None) -> None:
        """Expect this value from now on; None while it is being changed."""
        if value is None:
            self._expected.pop(operand, None)
        else:
            self._expected[operand] = value

    async def learn_values(self) -> None:
        """Read all settings; they are the expected ones. A setting that the controller cannot report is not watched."""
        self._changed.clear()
        self._program_differs = False
        self._expected = {}
        for part in pack_operands([item.operand for item in self._items]):
            self._expected |= await self._read_known(part)
        known_items = self._known_items()
        self._critical = self._select_critical(known_items)
        self._setting_parts = self._split_rest(known_items)
        self._program_parts = self._split_program()
        self._turn = 0

    async def _read_known(self, operands: Sequence[str]) -> dict[str, float]:
        try:
            values, _ = await self._device.session.read_numbers(*operands)
        except SmcCommandRefused as refusal:
            if len(operands) > 1:
                known_values: dict[str, float] = {}
                for operand in operands:
                    known_values |= await self._read_known([operand])
                return known_values
            self._device.log.warning(f"{operands[0]} is not watched: {refusal.text}")
            return {}
        return dict(zip(operands, values, strict=True))

    def _split_rest(self, known: Sequence[_Item]) -> list[Sequence[_Item]]:
        """Split what is not critical into the parts of single checks."""
        other_items = [item for item in known if item not in self._critical]
        size = SLOW_SETTINGS_AT_ONCE if self._slow else SETTINGS_AT_ONCE
        return [other_items[at : at + size] for at in range(0, len(other_items), size)]

    def _split_program(self) -> list[range]:
        count, size = len(self._device.resident.lines), SLOW_LINES_AT_ONCE if self._slow else LINES_AT_ONCE
        return [range(at, min(at + size, count)) for at in range(0, count, size)]

    # Checks

    async def find_differences(self, *, everything: bool) -> list[SettingDifference]:
        """Return the differences of all settings, or of the critical ones and the next part of the others. On a slow
        line, `everything` is the critical settings, and otherwise they alternate with the parts.

        Raises `LinkClosed`, `ControllerFault`.
        """
        try:
            if everything:
                await self._leave_contour_mode()
                return await self._compare(self._critical if self._slow else self._known_items())
            part = self._next_part()
            if isinstance(part, range):
                differences = await self._compare_program(part)
            else:
                differences = await self._compare(part)
            return differences if self._slow else [*await self._compare(self._critical), *differences]
        except SmcCommandRefused as refusal:
            # For example at level 2 of LC, which locks everything (L6735).
            return [
                SettingDifference(
                    "the lock (LC)",
                    f"such that settings are not reported ({refusal.text})",
                    "0",
                    repairable=False,
                    remedy="unlock it (LC password,0), then `tutti reset`",
                )
            ]

    def _select_critical(self, items: Sequence[_Item]) -> list[_Item]:
        critical = SLOW_CRITICAL if self._slow else CRITICAL
        return [item for item in items if item.setting.command in critical]

    def _known_items(self) -> list[_Item]:
        return [item for item in self._items if item.operand in self._expected]

    def _next_part(self) -> Sequence[_Item] | range:
        """Return what the next check at rest reads: on a slow line the critical settings every other time, and between
        them a part of the program after three of the other settings; otherwise the two in turn."""
        self._turn += 1
        turn = self._turn
        if self._slow:
            if turn % 2:
                return self._critical
            turn //= 2
        settings, program = self._setting_parts, self._program_parts
        every = PROGRAM_TURN if self._slow else 2
        if not settings or (program and turn % every == 0):
            return program[turn // every % len(program)] if program else self._critical
        return settings[(turn - turn // every) % len(settings)]

    async def _compare(self, items: Sequence[_Item]) -> list[SettingDifference]:
        expected_before = dict(self._expected)
        if self._slow and items is self._critical and await self._device.session.sums_to_zero(self._deviations()):
            return []
        values = await self._read_values(items)
        differences: list[SettingDifference] = []
        for item in items:
            expected_value = self._expected.get(item.operand)
            # What was changed by the adapter itself meanwhile (soft limits) is compared in the next check.
            if expected_value is None or expected_before.get(item.operand) != expected_value:
                continue
            value = values[item.operand]
            if item.differs(value, expected_value):
                self._changed.add(item.operand)
                self._program_differs |= item.setting.command == LABELS
                differences.append(item.to_difference(value, expected_value))
        return differences

    def _deviations(self) -> list[str]:
        """Return terms, none of which is negative, that are all 0 as long as the critical settings are as expected."""
        return [
            f"@ABS[{item.operand}-{format_value(expected_value)}]" if expected_value else f"@ABS[{item.operand}]"
            for item in self._critical
            for expected_value in [self._expected[item.operand]]
        ]

    async def _read_values(self, items: Iterable[_Item]) -> dict[str, float]:
        operands = [item.operand for item in items]
        values = await self._device.session.read_many(operands)
        return dict(zip(operands, values, strict=True))

    async def _compare_program(self, lines: range) -> list[SettingDifference]:
        wanted_lines = self._device.resident.lines[lines.start : lines.stop]
        held_lines = await self._device.list_program_lines(lines.start, lines.stop - 1)
        for number, line in zip(lines, wanted_lines, strict=True):
            text = held_lines[number - lines.start] if number - lines.start < len(held_lines) else ""
            if text != line:
                self._program_differs = True
                return [SettingDifference(f"line {number} of the resident program", repr(text), repr(line))]
        return []

    async def _leave_contour_mode(self) -> None:
        """Leave the mode that another client may have entered: until its first CD nothing reports it, and it refuses
        BG (18). A controller may refuse CD 0 outside the mode."""
        with suppress(SmcCommandRefused):
            await self._device.session.send_settings(LEAVE_CONTOUR)

    # Repair

    async def restore_values(self) -> None:
        """Write again what another client has changed, as far as a reset may do that. Raises `Refusal`,
        `ControllerFault`."""
        record = await self._device.read_record()
        if any(axis.is_moving for axis in record.axes):
            self._device.log.info("an axis moves: no setting is written again")
            return
        await self._leave_contour_mode()
        items = [item for item in self._known_items() if item in self._critical or item.operand in self._changed]
        values = await self._read_values(items)
        for item in items:
            expected_value = self._expected[item.operand]
            writable = not item.setting.remedy and item.setting.command != LABELS
            if writable and item.differs(values[item.operand], expected_value):
                self._device.log.info(
                    f"{item.operand} is written again", found=values[item.operand], value=expected_value
                )
                await self._device.session.send_command(self._write_command(item, expected_value))
        if self._program_differs:
            await self._device.install_program()
        self._changed.clear()
        self._program_differs = False

    def _write_command(self, item: _Item, value: float) -> str:
        command = item.setting.command
        if command.startswith("CN"):
            return f"CN {',' * int(command[2:])}{format_value(value)}"
        return f"{command}{item.letter}={format_value(value)}" if item.axis else f"{command} {format_value(value)}"


def _list_items(watched: WatchedSettings, motors: Iterable[tuple[str, int]]) -> list[_Item]:
    controller_items = [_Item(setting, None, "") for setting in watched.controller]
    return controller_items + [
        _Item(setting, name, AXIS_LETTERS[index]) for name, index in motors for setting in watched.axis
    ]


async def require_uncoupled(device: SmcDevice, motors: Mapping[str, int], *, gantry: Callable[[str], str]) -> None:
    """Switch off gearing that was left on (GR is burned, L3256-3277), of axes at rest; log it.

    GR 0 takes effect at once (L13526), so an axis that follows its master now would stop without a ramp, and motors
    that drive one load on both sides (GM, L5527) would be torn apart by the next move: both are left as they are.
    gantry: from a letter to the operand of its gantry mode, "" where the model has none.

    Raises `ControllerFault` (`config-mismatch`) in these cases, and while a cam is enabled: its positions are not those
    of the axes.
    """
    (cam,), _ = await device.session.read_numbers("_EB")
    if cam:
        raise ControllerFault(
            "config-mismatch",
            "the cam mode (EB) is 1, wanted 0",
            "end the program that uses the cam, set EB 0, then home the axes again",
        )
    ratios = await device.session.read_many([f"_GR{AXIS_LETTERS[index]}" for index in motors.values()])
    for (name, index), ratio in zip(motors.items(), ratios, strict=True):
        if not ratio:
            continue
        letter = AXIS_LETTERS[index]
        (speed,), _ = await device.session.read_numbers(f"_TV{letter}")
        gantry_mode = 0.0
        if gantry(letter):
            (gantry_mode,), _ = await device.session.read_numbers(gantry(letter))
        if speed or gantry_mode:
            reason = "in gantry mode (GM)" if gantry_mode else "and it moves"
            raise ControllerFault(
                "config-mismatch",
                f"axis {name}: gearing (GR{letter}) is {ratio:g} {reason}, wanted 0",
                f"remove the axis from the fleet file if it belongs to its master; otherwise set GR{letter}=0, then BN",
                name,
            )
        device.log.warning(f"gearing was left on and is switched off: GR{letter} was {ratio:g}", axis=name)
        await device.session.send_command(f"GR{letter}=0")
