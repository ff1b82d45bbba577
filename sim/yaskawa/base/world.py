"""Physical environment of the controller: inputs, switches, edges and index pulses."""

from dataclasses import dataclass, field

from sim.core.controller import LimitSwitch


@dataclass(slots=True)
class PhysicalEnvironment:
    """State set from outside. Positions are physical, in counts: 0 at power-up, independent of `DP`."""

    inputs: list[bool]
    analog: list[float] = field(default_factory=list[float])
    """Volts; empty without analog inputs."""
    limits: dict[str, LimitSwitch] = field(default_factory=dict[str, LimitSwitch])
    home: dict[str, bool] = field(default_factory=dict[str, bool])
    home_edge: dict[str, int] = field(default_factory=dict[str, int])
    index_every: dict[str, int] = field(default_factory=dict[str, int])
    travel: dict[str, tuple[int, int]] = field(default_factory=dict[str, tuple[int, int]])
    names: dict[str, str] = field(default_factory=dict[str, str])
    """Of axes, in the record of true motions, where these are not the machine's own."""

    def home_level(self, axis: str, place: float) -> bool:
        """Return the home input with the axis at a physical position; high by default."""
        if axis in self.home:
            return self.home[axis]
        edge = self.home_edge.get(axis)
        return True if edge is None else place >= edge
