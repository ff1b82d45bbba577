"""Checks of settings at rest, until every part has had its turn."""

from adapters.contract import Driver, SettingDifference


async def find_at_rest(driver: Driver, turns: int) -> dict[str, SettingDifference]:
    """The differences of some checks at rest, by item."""
    found: dict[str, SettingDifference] = {}
    for _ in range(turns):
        found |= {each.item: each for each in await driver.check_settings(everything=False)}
    return found
