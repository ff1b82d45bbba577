"""The current state of a controller in its adapter: the source of its state on the bus."""

from collections.abc import Iterable
from dataclasses import dataclass, field

from adapters.contract import ControllerIdentity, ControllerReading, SettingDifference
from adapters.controller.state.play import PlayFollower
from orchestrator.model.errors import SETTING_CHANGED, Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.state import FaultReport

STARTING = FaultReport(code="starting", text="the adapter has not reached the controller yet", remedy="wait")


@dataclass(slots=True)
class ControllerStatus:
    """State of one controller in its adapter.

    reading: the last poll; None while the controller is unreachable.
    referenced: by axis.
    play: how far axes are ahead of their motors, where their drives have play.
    homing: axes that are searching for their reference.
    jogging: axes that are jogging.
    probing: axes that move until an input changes.
    braked: axes whose motor is on and whose brake is not open yet.
    stopping_until_ns: until when a motion without a step counts as a stop, host time.
    stopped_ns: when the last stop was sent.
    stop_unseen: the controller has not been seen at rest since that stop.
    begun_by_ns: when the step that was loaded at that stop would have begun.
    may_move: no poll yet, or none since the link broke in or before a motion: an earlier process may have left the
    controller moving.
    restarts: number of restarts of the controller that polls have shown.
    ordered_ns: when the last order that may change positions was given by this adapter: a step, a jog, a search for the
    reference, motors on or off, a stop.
    differences: settings that are not as this adapter has left them, by item, until a reset or a new connection."""

    config: Controller
    referenced: dict[str, bool] = field(init=False)
    play: PlayFollower = field(init=False)
    reading: ControllerReading | None = None
    identity: ControllerIdentity | None = None
    homing: set[str] = field(default_factory=set[str])
    jogging: set[str] = field(default_factory=set[str])
    probing: set[str] = field(default_factory=set[str])
    braked: set[str] = field(default_factory=set[str])
    faults: list[FaultReport] = field(default_factory=lambda: [STARTING])
    stopping_until_ns: int = 0
    stopped_ns: int = 0
    stop_unseen: bool = False
    begun_by_ns: int = 0
    may_move: bool = True
    restarts: int = 0
    ordered_ns: int = 0
    differences: dict[str, SettingDifference] = field(default_factory=dict[str, SettingDifference])

    def __post_init__(self) -> None:
        self.forget_references()
        self.play = PlayFollower(self.config)

    @property
    def searching(self) -> set[str]:
        """Axes that move until they find something: their reference, or a contact."""
        return self.homing | self.probing

    @property
    def moved_singly(self) -> set[str]:
        """Axes that an order moves without a step."""
        return self.homing | self.probing | self.jogging

    def require_online(self) -> ControllerReading:
        """Return the last reading. Raises `Refusal` with the reason when there is none."""
        if self.reading is None:
            fault = self.faults[0] if self.faults else STARTING
            raise Refusal("offline", f"the controller is unreachable: {fault.text}", fault.remedy)
        return self.reading

    def forget_references(self) -> None:
        """Mark all axes as not referenced."""
        self.referenced = dict.fromkeys(self.config.axes, False)

    def limits_counts(self, axes: Iterable[str]) -> dict[str, tuple[int, int] | None]:
        """Return the soft limits that apply to the motors of `axes` now: None for an axis with an unknown position."""
        return {name: self.config.axes[name].motor_limits_counts if self.referenced[name] else None for name in axes}

    def require_known(self, axes: Iterable[str]) -> None:
        """Raise `Refusal` for an axis that the controller does not have."""
        for name in axes:
            if name not in self.config.axes:
                raise Refusal("unknown-axis", f"no axis {name}; axes: {', '.join(self.config.axes)}")

    def require_enabled(self, axes: Iterable[str]) -> None:
        """Raise `Refusal` for an axis whose motor is off or whose brake is not open."""
        reading = self.require_online()
        for name in axes:
            if not reading.axes[name].enabled:
                raise Refusal(
                    "not-enabled",
                    f"axis {name} is not enabled",
                    "enable it first: a step `do: enable`, or `tutti axis enable`",
                )
            if name in self.braked:
                raise Refusal("braked", f"the brake of axis {name} is not open yet", "wait a moment")

    def require_no_fault(self) -> None:
        """Raise `Refusal` while the controller reports a fault."""
        if self.faults:
            first = self.faults[0]
            raise Refusal(first.code if first.code == SETTING_CHANGED else "fault", first.text, first.remedy)
