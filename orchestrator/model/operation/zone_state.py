"""Keep-out zones now: where the bodies are, and how far rules are from being broken."""

from pydantic import Field

from orchestrator.model.base import Id, Model
from orchestrator.model.messages import Reply
from orchestrator.model.zone_fields import Vector


class BodyOutline(Model):
    """A body or a region where it is, in the machine's frame, mm.

    Convex: the hull of its corners; of a sphere, `radius` around its one corner. edges: pairs of corners, for a
    drawing. certain: the positions of all axes that carry it are known; else it is in the middle of their ranges.
    """

    corners: list[Vector]
    edges: list[tuple[int, int]] = Field(default=[])
    radius: float = 0.0
    certain: bool = True
    description: str = ""


class RuleReading(Model):
    """A rule now, with the last positions that were read, without their uncertainty.

    bodies: those that it names, and its region by the name of the rule; none of a relation. holds: None where that is
    not known, because an axis may be anywhere in its range. distance: between the bodies, mm, and least: what it must
    be; None for a relation, or where it is not known. text: in words.
    """

    rule: Id
    bodies: list[str] = Field(default=[])
    holds: bool | None
    distance: float | None = None
    least: float | None = None
    trust_step: bool = False
    text: str

    @property
    def verdict(self) -> str:
        """Whether it holds, in a word."""
        return "not known" if self.holds is None else "holds" if self.holds else "BROKEN"


class ZoneState(Reply):
    """The keep-out zones of a fleet, all empty for one without. Software, no safety function.

    regions: of the rules that keep a body out, by rule. positions: motor positions of the real axes that rules depend
    on, in their units. unknown: why the others may be anywhere in their ranges, by axis. ways: where a positive motion
    of an axis leads, mm per unit, of axes that move a body without turning it.
    """

    bodies: dict[str, BodyOutline] = Field(default={})
    regions: dict[str, BodyOutline] = Field(default={})
    rules: list[RuleReading] = Field(default=[])
    positions: dict[str, float] = Field(default={})
    unknown: dict[str, str] = Field(default={})
    ways: dict[str, Vector] = Field(default={})
