"""Registered positions (PIT) and registered coordinates (PAV), 20 records each (L7692-L7911)."""

from dataclasses import dataclass, field

RECORDS = 20


@dataclass(slots=True)
class PositionRecords:
    """Records by number 1-20, one value per axis, pulses.

    A PIT record is a position of the stage: zeroing the counter does not change it (L7752). It is lost with the power
    (L7712). A PAV record is coordinate values, kept in the main memory (L7831).
    """

    stage_positions: dict[int, tuple[int, int, int]] = field(default_factory=dict[int, tuple[int, int, int]])
    coordinates: dict[int, tuple[int, int, int]] = field(default_factory=dict[int, tuple[int, int, int]])

    def forget_positions(self) -> None:
        """Power off, RESET, or a restart after a memory-switch change."""
        self.stage_positions.clear()
