"""Settings that are compared in two ways: what determines where a motion goes, or the next part of all, in turn."""

from collections.abc import Sequence
from typing import Protocol

from adapters.contract import DriverLog, SettingDifference


class SettingsComparison(Protocol):
    """The watched settings of one connection."""

    async def check_motion(self) -> Sequence[SettingDifference]:
        """Compare what determines where a motion goes."""
        ...

    async def check_next(self) -> Sequence[SettingDifference]:
        """Compare the next part of all settings."""
        ...


async def check_watched_settings(
    watch: SettingsComparison, log: DriverLog, *, everything: bool
) -> Sequence[SettingDifference]:
    """Do what `Driver.check_settings` states, and log each difference."""
    differences = await (watch.check_motion() if everything else watch.check_next())
    for difference in differences:
        log.warning(f"another client has changed a setting: {difference.item}", found=difference.found)
    return differences
