"""The fleets of this process that are running, so that one that a test has left can be ended."""

from typing import Protocol


class OpenFleet(Protocol):
    """A fleet that runs until it is closed."""

    def close(self) -> None: ...


_running: list[OpenFleet] = []


def add(fleet: OpenFleet) -> None:
    """Note a fleet that has been started."""
    _running.append(fleet)


def discard(fleet: OpenFleet) -> None:
    """Note that a fleet has ended."""
    if fleet in _running:
        _running.remove(fleet)


def list_running() -> list[OpenFleet]:
    """All that run now, in order of their start."""
    return list(_running)
