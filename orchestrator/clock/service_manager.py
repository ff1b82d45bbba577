"""Messages to the service manager that has started this process: systemd, by `sd_notify(3)`.

Started by hand there is none, and nothing is sent. A watchdog is fed only while the process makes progress, so that a
process that hangs, or works no more for another reason, is restarted.
"""

import asyncio
import os
import socket
from collections.abc import Callable, Mapping
from contextlib import suppress
from itertools import count

READY, STOPPING, WATCHDOG = "READY=1", "STOPPING=1", "WATCHDOG=1"
FEEDS = 3  # of the watchdog in each of its periods: one may be late


class ServiceManager:
    """The service manager, by the environment of this process."""

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        self._address = environment.get("NOTIFY_SOCKET", "")
        period_us = environment.get("WATCHDOG_USEC", "")
        self.watchdog_s = int(period_us) / 1e6 if self._address and period_us.isdecimal() else None
        """The period of the watchdog; None without one."""

    def notify(self, message: str) -> None:
        """Send a message; one that cannot be sent is lost, like that of a process without a manager."""
        if not self._address:
            return
        address = f"\0{self._address[1:]}" if self._address.startswith("@") else self._address
        with suppress(OSError), socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.connect(address)
            sender.sendall(message.encode())

    async def run_alone(self) -> None:
        """Announce that this process is ready, and feed the watchdog while its event loop runs."""
        self.notify(READY)
        turns = count()
        await self.feed_watchdog(lambda: next(turns))

    async def feed_watchdog(self, count_progress: Callable[[], int]) -> None:
        """Feed the watchdog from this event loop, whenever the count has changed since the last time; without a
        watchdog return at once."""
        last = -1
        while self.watchdog_s is not None:
            count = count_progress()
            if count != last:
                self.notify(WATCHDOG)
            last = count
            await asyncio.sleep(self.watchdog_s / FEEDS)
