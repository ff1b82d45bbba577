"""The incremental encoder of one axis: its counter, and how the mechanics drive it."""

from dataclasses import dataclass


@dataclass(slots=True)
class Encoder:
    """Counter content in increments. A coupled encoder follows the mechanical position (motor steps).

    per_step: increments per motor step with signal multiplication 1.
    """

    per_step: float | None
    """None: not coupled, the counter holds what it was told."""
    content: int = 0
    anchor: float = 0.0
    """Mechanical position at which the counter was `content`."""
    stalled_at: float | None = None

    def read(self, mechanical: float, multiplication: int) -> int:
        """Counter content with the motor at `mechanical`."""
        if self.per_step is None:
            return self.content
        place = mechanical if self.stalled_at is None else self.stalled_at
        return self.content + round((place - self.anchor) * self.per_step * multiplication)

    def load(self, content: int, mechanical: float) -> None:
        """Set the counter with the motor at `mechanical`."""
        self.content = content
        self.anchor = mechanical if self.stalled_at is None else self.stalled_at

    def stall(self, mechanical: float) -> None:
        """The stage sticks where it is."""
        if self.stalled_at is None:
            self.stalled_at = mechanical

    def release(self, mechanical: float) -> None:
        """The stage follows again; the steps of the meantime are lost."""
        if self.stalled_at is not None:
            self.anchor += mechanical - self.stalled_at
            self.stalled_at = None
