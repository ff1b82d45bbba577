"""Electronic gearing: a share of the axis' command that follows a master (L5421-L5580, L13519-L13640)."""

from collections.abc import Callable


class Gear:
    """Adds ratio x the master's travel. Evaluated when somebody asks; positions in counts, time in samples."""

    def __init__(self) -> None:
        self.source = ""
        """Master: X..W encoder, CX..CW command, DX..DW auxiliary encoder, S, T, N; empty for none."""
        self.ratio = 0.0
        self.gantry = False
        self.on = False
        self._master: Callable[[float], float] | None = None
        self._base = 0.0
        self._origin = 0.0

    def select(self, source: str, master: Callable[[float], float] | None, at: float) -> None:
        """`GA`."""
        self._hold(at)
        self.source, self._master = source, master
        self._resume(at)

    def set_ratio(self, ratio: float, at: float) -> None:
        """`GR`: takes effect at once; 0 switches off."""
        self._hold(at)
        self.ratio = ratio
        self._resume(at)

    def restart(self, at: float) -> None:
        """Count from here."""
        self._base = 0.0
        self._resume(at)

    def position(self, at: float) -> float:
        if self._master is None or not self.ratio:
            return self._base
        return self._base + self.ratio * (self._master(at) - self._origin)

    def velocity(self, at: float) -> float:
        """Counts per sample."""
        return self.position(at) - self.position(at - 1) if self.ratio else 0.0

    @property
    def engaged(self) -> bool:
        return self._master is not None and self.ratio != 0.0

    def _hold(self, at: float) -> None:
        self._base = self.position(at)

    def _resume(self, at: float) -> None:
        self._origin = self._master(at) if self._master is not None else 0.0
        self.on = self.engaged or self._base != 0.0
