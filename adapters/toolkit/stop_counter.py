"""Stops that overtake commands: a command that waits for its turn must not start a motion after a stop."""

from collections import Counter
from collections.abc import Awaitable, Callable, Iterable
from contextlib import suppress

from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import Refusal


class StopCounter:
    """Counts the stops of every motor of one connection."""

    def __init__(self) -> None:
        self._counts: Counter[int] = Counter()

    def record_stop(self, motors: Iterable[int]) -> None:
        """Record a stop that is written for these motors."""
        self._counts.update(motors)

    def stop_count(self, motor: int) -> int:
        """Return a number that every stop of this motor increments."""
        return self._counts[motor]

    def require_no_stop(self, axis: str, motor: int, since: int) -> None:
        """Raise `Refusal` when a stop has come since `stop_count` returned `since`."""
        if self._counts[motor] != since:
            raise Refusal("stopped", f"axis {axis} was stopped meanwhile", "")


async def send_or_brake(
    send: Callable[[Callable[[], None]], Awaitable[object]], check: Callable[[], None], brake: Callable[[], object]
) -> None:
    """Send a command that moves a motor; brake the motor when the result of a sent command is unknown.

    send: sends the command, after it has called its argument. check: raises `Refusal` when the command must not be
    sent. A `Refusal` after that is the controller's answer: the motor is at rest.
    """
    is_sent = False

    def check_and_mark() -> None:
        nonlocal is_sent
        check()
        is_sent = True

    try:
        await send(check_and_mark)
    except Refusal:
        raise
    except BaseException:
        # Cancelled or unanswered: no caller would stop it later.
        if is_sent:
            with suppress(LinkClosed):
                brake()
        raise
