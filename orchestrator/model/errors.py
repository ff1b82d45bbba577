"""The errors of Tutti: one tree below `TuttiError`.

An error carries what a user needs: what is wrong, with which value, and what to do about it. `str(error)` is that text.
"""

from typing import Any

SETTING_CHANGED = "setting-changed"
"""Code of a controller whose settings another client has changed: what would move waits until they are as before."""
NOT_REFERENCED = "not-referenced"
"""Code of an axis whose position is not known: it must be homed before it moves to a position."""
LATE_REMEDY = (
    "lighten the load of the computer, or give starts more time in the fleet file: `starts: {release: 100 ms}`"
)
"""Of a start that came too late."""

MAX_ERROR_TEXT = 2000  # characters; what a controller has sent may be in it, and need not end
_SHOWN_BEGIN, _SHOWN_END = 1600, 300


def shorten_text(text: str) -> str:
    """Return a text without its middle if it is longer than an error needs."""
    if len(text) <= MAX_ERROR_TEXT:
        return text
    left_out = len(text) - _SHOWN_BEGIN - _SHOWN_END
    return f"{text[:_SHOWN_BEGIN]} … ({left_out} characters are left out) … {text[-_SHOWN_END:]}"


class TuttiError(Exception):
    """The root of all errors that Tutti raises on purpose."""


class Refusal(TuttiError):
    """A request that was not carried out; nothing has moved because of it.

    code: for programs; it does not change between versions. text: what is wrong. remedy: what to do about it, may be
    empty. controller: the controller that refuses, None where it is the service itself or the adapter's own.
    """

    def __init__(self, code: str, text: str, remedy: str = "", controller: str | None = None) -> None:
        self.text = shorten_text(text)
        super().__init__(self.text)
        self.code = code
        self.remedy = remedy
        self.controller = controller
        if remedy:
            self.add_note(remedy)  # a script that does not catch it shows what to do

    def __reduce__(self) -> tuple[Any, ...]:
        """To pass it to another process, as a plain refusal."""
        return Refusal, (self.code, self.text, self.remedy, self.controller)


class NotAllowed(Refusal):
    """A request that the role of this connection's identity may not make."""


class NoName(TuttiError, ValueError):
    """A text that cannot be the name of a part of a fleet, and so the name of none."""


class ControllerFault(TuttiError):
    """A controller that does not do what its manual says: silence, garbage, or an error that it reports.

    code: for programs. text, remedy: what happened, and what to do. axis: the axis concerned, by its name in the fleet
    file; None: the whole controller.
    """

    def __init__(self, code: str, text: str, remedy: str, axis: str | None = None) -> None:
        self.text = shorten_text(text)
        super().__init__(self.text)
        self.code = code
        self.remedy = remedy
        self.axis = axis
