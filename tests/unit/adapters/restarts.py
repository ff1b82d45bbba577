"""How drivers report a controller that was restarted on an open line."""

import pytest

from adapters.contract import ControllerRestarted, Driver


async def sees_the_restart(driver: Driver) -> None:
    """A poll gives the link up at once, and the first one after the reconnection reports the reason, once."""
    with pytest.raises(ControllerRestarted):
        await driver.poll()
    await driver.close()
    await driver.connect()
    await driver.configure()
    assert [(await driver.poll()).restarted for _ in range(2)] == [True, False]
