"""What tells the models of the family apart."""

from dataclasses import dataclass, field

from sim.yaskawa.statements import Command

SYSTEM_OPS = frozenset(("VA", "VD", "VS", "VR", "VT", "AV"))
HANDLE_OPS = frozenset(("IH", "SA", "MB", "HS"))


@dataclass(frozen=True, eq=False)
class Model:
    """One model: its name, what `^R^U` tells, its ports, its commands, and the time bases it takes (`TM`)."""

    name: str
    revision: str
    ports: tuple[str, ...]
    commands: dict[str, Command]
    handles: str = "ABCDEFGH"
    time_bases: tuple[int, int, int] = (250, 20000, 125)
    """Least and greatest `TM`, and its step, in nominal microseconds."""
    defaults: dict[str, int] = field(default_factory=dict[str, int])
    """Parameters of axes that differ from the family's, raw."""

    def suffixes(self, op: str) -> str:
        """Letters that may follow `op` in `XXa=value` (axes in their X Y Z W names)."""
        if op in HANDLE_OPS:
            return "XYZWABCDEFGHST"
        return "XYZWNST" if op in SYSTEM_OPS else "XYZWN"
