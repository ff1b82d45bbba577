"""Patterns of reply lines, in an engine whose time is linear in the line: RE2, which does not backtrack."""

from collections.abc import Mapping
from typing import Any

import re2

from orchestrator.model.errors import TuttiError

MOST_CHARACTERS = 1000  # of a pattern
_re2: Any = re2


class BadPattern(TuttiError, ValueError):
    """A pattern that cannot be used; the message states the reason."""


class LinePattern:
    """A pattern that a whole line must match; its named groups are values."""

    def __init__(self, text: str) -> None:
        """Raises `BadPattern`."""
        self.text = text
        if len(text) > MOST_CHARACTERS:
            raise BadPattern(f"the pattern has {len(text)} characters, at most are {MOST_CHARACTERS}")
        options: Any = _re2.Options()
        options.log_errors = False
        options.max_mem = 1 << 20
        try:
            self._compiled: Any = _re2.compile(text, options)
        except _re2.error as error:
            reason = error.args[0].decode() if isinstance(error.args[0], bytes) else str(error.args[0])
            raise BadPattern(f"{text!r} is no pattern of RE2 (no look-around, no back references): {reason}") from None

    @property
    def groups(self) -> frozenset[str]:
        """The names of its groups."""
        return frozenset(self._compiled.groupindex)

    def match(self, line: str) -> Mapping[str, str] | None:
        """Return the named groups, or None for a line that does not match. A group without a part is left out."""
        line_match = self._compiled.fullmatch(line)
        return (
            None
            if line_match is None
            else {name: text for name, text in line_match.groupdict().items() if text is not None}
        )

    def matches(self, line: str) -> bool:
        """Return whether the line matches."""
        return self._compiled.fullmatch(line) is not None
