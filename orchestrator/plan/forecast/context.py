"""Where in a job a forecast is."""

from dataclasses import dataclass, field, replace

from orchestrator.model.fleet import Axis
from orchestrator.model.names import controller_of
from orchestrator.plan.forecast.passes import TargetCheck


@dataclass(frozen=True, slots=True)
class TargetField:
    """The target of an axis in a step. key: the field of the step that has it, by axis. virtual_place: of the virtual
    axis whose target it follows from."""

    key: str
    name: str
    axis: Axis
    virtual_place: tuple[str, str] | None = None

    @property
    def place(self) -> tuple[str, str]:
        """Its place in the step."""
        return self.virtual_place or (self.key, self.name)

    @property
    def controller(self) -> str:
        """The controller of its axis."""
        return controller_of(self.name)


@dataclass(frozen=True, slots=True)
class ForecastContext:
    """The step that is run forward, and when.

    index: of the written step in the job file. place: of the step itself, also inside repeats and scans. when: the pass
    of a repeat, or the point of a scan, in words for messages. checks: gets the targets that are compared with limits.
    """

    index: int
    place: tuple[str | int, ...] = ()
    when: str = ""
    checks: list[TargetCheck] = field(default_factory=list[TargetCheck])

    def at_inner(self, key: str, number: int) -> "ForecastContext":
        """The context of a step inside this one. key: the field that holds it."""
        return replace(self, place=(*self.place, key, number))

    def at_time(self, when: str) -> "ForecastContext":
        """The same place at another pass or point."""
        return replace(self, when=when)

    def at_place(self, place: tuple[str | int, ...], when: str) -> "ForecastContext":
        """Another place, at another pass."""
        return replace(self, place=place, when=when)

    def in_pass(self, when: str) -> "ForecastContext":
        """The same place in a pass that collects targets of its own."""
        return replace(self, when=when, checks=[])
