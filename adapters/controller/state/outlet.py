"""Where a controller's supervisor puts what it publishes: the host decides in which messages it goes."""

from typing import Protocol

from orchestrator.model.state import ControllerState


class StateOutlet(Protocol):
    """Publishes for the controllers of a host."""

    def offer_state(self, state: ControllerState) -> None:
        """Take the state as it is now. It is published if it has changed in more than its instants."""
        ...

    def note_answer(self, controller: str) -> None:
        """A state was given out as an answer: the next one is published, whether it has changed or not, because that
        one may be as the state before the answer was."""
        ...

    def put_event(self, controller: str, payload: bytes) -> None:
        """Publish an event; it must not be lost."""
        ...

    def put_value(self, controller: str, leaf: str, payload: bytes) -> None:
        """Publish what changes slowly. leaf: `clock` or `link`."""
        ...
