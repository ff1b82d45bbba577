"""How far an axis may be from its target, in words."""

from orchestrator.model.report import PositionBound


def describe_bound(axis: str, bound: PositionBound) -> str:
    """The bound of an axis with its causes: `gantry.x ends within 0.0015 mm of its target (…)`."""
    causes = {"rounding": bound.rounding, "table": bound.table, "play": bound.play}
    terms = ", ".join(f"{name} {value:.3g}" for name, value in causes.items() if value)
    return f"{axis} ends within {bound.most:.3g} {bound.unit} of its target ({terms})"
