"""State that survives power-off: configurations, programs, data files, last positions, network, password."""

from dataclasses import dataclass, field

from sim.ppsmc.settings import AxisSettings


@dataclass(slots=True)
class HardDisk:
    """The controller's hard disk. With the write filter on, data files written since the start are lost (L4737)."""

    default: list[AxisSettings]
    alternative: list[AxisSettings] | None = None
    """Saved by `update1`; only gear and speed profile count (L1296)."""
    append_unit: bool = False
    """pqrf (L1097)."""
    ignore_limits: bool = False
    """iel, permanent at once (L2120)."""
    programs: dict[str, list[str]] = field(default_factory=dict[str, list[str]])
    """Files *.smc in \\up, by lower-case name."""
    files: dict[str, str] = field(default_factory=dict[str, str])
    positions: list[int] | None = None
    """Step counters at the last shutdown (L2230)."""
    password: int = 0
    address: str = "192.168.250.201"
    mask: str = "255.255.255.0"
    eib_address: str = "192.168.253.212"
    eib_mask: str = "255.255.255.0"
    filtered: bool = False
    """The write filter has been active since the start."""
    filter_next: bool = False
    """The write filter becomes active at the next start (L4744)."""
    filter_spares_files: bool = False
    """fbwf_configure has excepted the data files."""
    _before: dict[str, str] = field(default_factory=dict[str, str])

    def start_system(self) -> None:
        """Start the operating system."""
        if self.filtered and not self.filter_spares_files:
            self.files = dict(self._before)
        self.filtered = self.filter_next
        self._before = dict(self.files)
