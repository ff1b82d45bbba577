"""Electronic gearing: a share of the axis' command that follows a master (L5421-L5580, L13519-L13640)."""

from collections.abc import Callable


class ElectronicGear:
    """Adds ratio x the master's travel. Evaluated on access; positions in counts, time in samples."""

    def __init__(self) -> None:
        self.source = ""
        """Master: X..W encoder, CX..CW command, DX..DW auxiliary encoder, S, T, N; empty for none."""
        self.ratio = 0.0
        self.gantry = False
        self.on = False
        self._master: Callable[[float], float] | None = None
        self._base = 0.0
        self._origin = 0.0

    def select_master(self, source: str, master: Callable[[float], float] | None, at: float) -> None:
        """`GA`."""
        self._freeze_share(at)
        self.source, self._master = source, master
        self._resume_share(at)

    def set_ratio(self, ratio: float, at: float) -> None:
        """`GR`: takes effect at once; 0 switches off."""
        self._freeze_share(at)
        self.ratio = ratio
        self._resume_share(at)

    def restart_count(self, at: float) -> None:
        """Count from the present position."""
        self._base = 0.0
        self._resume_share(at)

    def position(self, at: float) -> float:
        if self._master is None or not self.ratio:
            return self._base
        return self._base + self.ratio * (self._master(at) - self._origin)

    def velocity(self, at: float) -> float:
        """Return counts per sample."""
        return self.position(at) - self.position(at - 1) if self.ratio else 0.0

    @property
    def is_engaged(self) -> bool:
        return self._master is not None and self.ratio != 0.0

    def _freeze_share(self, at: float) -> None:
        self._base = self.position(at)

    def _resume_share(self, at: float) -> None:
        self._origin = self._master(at) if self._master is not None else 0.0
        self.on = self.is_engaged or self._base != 0.0
