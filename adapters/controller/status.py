"""What an adapter knows of its controller at a moment: the raw material of its state on the bus."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from adapters.contract import CannotDo, Identity, Reading
from orchestrator.model.fleet import Controller
from orchestrator.model.state import Fault

STARTING = Fault(code="starting", text="the adapter has not reached the controller yet", remedy="wait")


@dataclass(slots=True)
class Condition:
    """reading: the last poll, None while the controller can not be reached. referenced: by axis. homing: axes that look
    for their reference now. jogging: axes moved by hand. braked: axes whose motor is on and whose brake is not open
    yet. stopping_until_ns: until when a motion without a step is a stop, host time; stopped_ns: when it was last told
    to stop; stop_unseen: it has not been seen at rest since; begun_by_ns: when what was loaded then would have begun.
    may_move: nobody has seen it yet, or since its link broke in motion or before one: who was here before may have left
    it moving. restarts: of the controller, as far as polls have shown them."""

    config: Controller
    referenced: dict[str, bool] = field(init=False)
    reading: Reading | None = None
    identity: Identity | None = None
    homing: set[str] = field(default_factory=set[str])
    jogging: set[str] = field(default_factory=set[str])
    braked: set[str] = field(default_factory=set[str])
    faults: list[Fault] = field(default_factory=lambda: [STARTING])
    stopping_until_ns: int = 0
    stopped_ns: int = 0
    stop_unseen: bool = False
    begun_by_ns: int = 0
    may_move: bool = True
    restarts: int = 0

    def __post_init__(self) -> None:
        self.forget_references()

    def online(self) -> Reading:
        """The last reading. Raises `CannotDo` with the reason when there is none."""
        if self.reading is None:
            fault = self.faults[0] if self.faults else STARTING
            raise CannotDo("offline", f"the controller can not be reached: {fault.text}", fault.remedy)
        return self.reading

    def forget_references(self) -> None:
        """No axis knows where it is any more."""
        self.referenced = dict.fromkeys(self.config.axes, False)

    def limits_counts(self, axes: Iterable[str]) -> dict[str, tuple[int, int] | None]:
        """The soft limits that bind `axes` now: none where the axis does not know where it is."""
        return {name: self.config.axes[name].soft_limits_counts if self.referenced[name] else None for name in axes}

    def require_known(self, axes: Iterable[str]) -> None:
        """Raises `CannotDo` for an axis that the controller does not have."""
        for name in axes:
            if name not in self.config.axes:
                raise CannotDo("unknown-axis", f"no axis {name}; axes: {', '.join(self.config.axes)}")

    def require_enabled(self, axes: Iterable[str]) -> None:
        """Raises `CannotDo` for an axis whose motor is off or whose brake is not open."""
        reading = self.online()
        for name in axes:
            if not reading.axes[name].enabled:
                raise CannotDo(
                    "not-enabled",
                    f"axis {name} is not enabled",
                    "enable it first: a step `do: enable`, or `tutti axis enable`",
                )
            if name in self.braked:
                raise CannotDo("braked", f"the brake of axis {name} is not open yet", "wait a moment")

    def require_no_fault(self) -> None:
        """Raises `CannotDo` while the controller reports a fault."""
        if self.faults:
            raise CannotDo("fault", self.faults[0].text, self.faults[0].remedy)
