"""The incremental encoder of one axis: its counter, and its coupling to the mechanics."""

from dataclasses import dataclass


@dataclass(slots=True)
class IncrementalEncoder:
    """Counter content in increments. A coupled encoder follows the mechanical position (motor steps).

    per_step: increments per motor step with signal multiplication 1.
    """

    per_step: float | None
    """None: not coupled, the counter keeps the value that was loaded."""
    content: int = 0
    anchor: float = 0.0
    """Mechanical position at which the counter was `content`."""
    stalled_at: float | None = None

    def read_counter(self, mechanical: float, multiplication: int) -> int:
        """Return the counter content with the motor at `mechanical`."""
        if self.per_step is None:
            return self.content
        position = mechanical if self.stalled_at is None else self.stalled_at
        return self.content + round((position - self.anchor) * self.per_step * multiplication)

    def load_counter(self, content: int, mechanical: float) -> None:
        """Set the counter with the motor at `mechanical`."""
        self.content = content
        self.anchor = mechanical if self.stalled_at is None else self.stalled_at

    def stall_stage(self, mechanical: float) -> None:
        """Block the stage at its present position."""
        if self.stalled_at is None:
            self.stalled_at = mechanical

    def free_stage(self, mechanical: float) -> None:
        """Free the stage; the steps made meanwhile are lost."""
        if self.stalled_at is not None:
            self.anchor += mechanical - self.stalled_at
            self.stalled_at = None
