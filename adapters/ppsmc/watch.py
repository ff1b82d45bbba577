"""Settings that motion relies on, compared with what the controller holds now: its touch screen, or another client, may
change them.

All are read by `?conf` (L3977), which an idle controller answers. Not compared: speeds and ramps, which are loaded and
read back for every move; texts for display; what no query shows (`pqrf`, `iel`, the lock of the touch screen).
"""

from collections.abc import Mapping, Sequence

from adapters.contract import SettingDifference
from adapters.ppsmc.replies import ASK_SETTINGS, SETTINGS, FormattedQuery, parse_settings
from adapters.ppsmc.unitstate import PpSmcState
from orchestrator.model.errors import Refusal

_SCALING = ("gnum", "gden", "gz", "gn", "conf", "def", "mdir", "mdi")
"""Distances stand for other steps after a change of these (L865-L931, L1022)."""
_ENCODER = ("ect", "edir", "eres", "esm", "est", "cf", "twen")
"""The same, of an axis in closed loop."""
_OTHERS = ("dcpl", "ecl", "edev", "mpr", "prst", "prt", "emips", "bln", "blp", "rofs", "hsdm", "sdm")
_WATCHED = frozenset((*_SCALING, *_ENCODER, *_OTHERS))
_SLOW_CALLS = 10
"""On a serial line the settings of one axis take half a second: they are read once in this many calls."""


def watched_settings(held: Mapping[str, str]) -> dict[str, str]:
    """Return the values of one axis that are compared."""
    return {name: value for name, value in held.items() if name in _WATCHED}


class PpSmcWatch:
    """The watched settings of one connection; expected are those in `unit.settings`. motors: axis names by number."""

    def __init__(self, unit: PpSmcState, motors: Mapping[int, str]) -> None:
        self._unit = unit
        self._motors = motors
        self._slow = unit.session.link.char_ns > 0
        self._calls = 0
        self.has_differences = False
        """Whether a difference has been found since the settings were last in order."""

    async def check_motion(self) -> list[SettingDifference]:
        """Compare all axes; on a serial line that is left to arming, which reads the same lines anyway."""
        return [] if self._slow else await self._compare(list(self._motors))

    async def check_next(self) -> list[SettingDifference]:
        """Compare the next axis in turn."""
        self._calls += 1
        motors = list(self._motors)
        if self._unit.suspects_settings:
            self._unit.suspects_settings = False
            return await self._compare(motors)
        if self._slow and self._calls % _SLOW_CALLS:
            return []
        turn = self._calls // (_SLOW_CALLS if self._slow else 1)
        return await self._compare([motors[turn % len(motors)]])

    async def restore_settings(self) -> None:
        """Write the expected values again, and read them back. Raises `Refusal`, `ControllerFault`."""
        if not self.has_differences:
            return
        session, wanted_settings = self._unit.session, self._unit.settings
        commands = [
            f"{name}{motor}:{wanted_settings[motor][name]}"
            for motor, held_settings in (await self._read_settings(list(self._motors))).items()
            for name, value in held_settings.items()
            if wanted_settings.get(motor, {}).get(name, value) != value
        ]
        if commands:
            session.log.info("settings that were changed are written again", commands=commands)
            await session.send_repeatable(commands)
            differences = await self._compare(list(self._motors))
            if differences:
                raise Refusal("setting-changed", differences[0].to_fault().text, "set it at the controller")
        self.has_differences = False

    # Internals

    async def _read_settings(self, motors: Sequence[int]) -> dict[int, dict[str, str]]:
        if self._unit.session.blocked or not self._unit.introduced:
            return {}
        query = FormattedQuery(f"?conf{motors[0]}", SETTINGS) if len(motors) == 1 else ASK_SETTINGS
        return parse_settings((await self._unit.session.send_queries(query)).reply_texts(query))

    async def _compare(self, motors: Sequence[int]) -> list[SettingDifference]:
        differences = find_differences(self._unit, self._motors, await self._read_settings(motors))
        self.has_differences = self.has_differences or bool(differences)
        return differences


def find_differences(
    unit: PpSmcState, motors: Mapping[int, str], found: Mapping[int, Mapping[str, str]]
) -> list[SettingDifference]:
    """Return the settings in `found` that differ from the expected ones."""
    return [
        SettingDifference(
            item=f"{name}{motor} (axis {motors[motor]})",
            found=value,
            expected=expected_value,
            axis=motors[motor],
            moves_reference=name in _SCALING or (name in _ENCODER and motor in unit.closed),
        )
        for motor, held_settings in found.items()
        if motor in motors
        for name, value in held_settings.items()
        if (expected_value := unit.settings.get(motor, {}).get(name)) is not None and value != expected_value
    ]


def require_settings(unit: PpSmcState, motors: Mapping[int, str], found: Mapping[int, Mapping[str, str]]) -> None:
    """Raise `Refusal` when settings that were read while arming differ from the expected ones."""
    differences = find_differences(unit, motors, found)
    if differences:
        unit.suspects_settings = True
        raise differences[0].to_refusal()
