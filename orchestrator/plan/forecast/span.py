"""How long steps take."""

from typing import NamedTuple


class Span(NamedTuple):
    """A duration, s. most: None if it has no bound."""

    least: float = 0.0
    most: float | None = 0.0

    def followed_by(self, other: "Span", times: int = 1) -> "Span":
        """The duration of this and then `other`, so many times."""
        most = None if self.most is None or other.most is None else self.most + other.most * times
        return Span(self.least + other.least * times, most)
