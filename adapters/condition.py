"""What an adapter knows of its controller at a moment: the raw material of its state on the bus."""

from dataclasses import dataclass, field

from adapters.contract import CannotDo, Identity, Reading
from orchestrator.model.state import Fault

STARTING = Fault(code="starting", text="the adapter has not reached the controller yet", remedy="wait")


@dataclass(slots=True)
class Condition:
    """reading: the last poll, None while the controller can not be reached. referenced: by axis. homing: axes that
    look for their reference now. stopping_until_ns: until when a motion without a step is a stop, host time."""

    referenced: dict[str, bool]
    reading: Reading | None = None
    identity: Identity | None = None
    homing: set[str] = field(default_factory=set[str])
    faults: list[Fault] = field(default_factory=lambda: [STARTING])
    stopping_until_ns: int = 0

    def online(self) -> Reading:
        """The last reading. Raises `CannotDo` with the reason when there is none."""
        if self.reading is None:
            fault = self.faults[0] if self.faults else STARTING
            raise CannotDo("offline", f"the controller can not be reached: {fault.text}", fault.remedy)
        return self.reading

    def forget_references(self) -> None:
        """No axis knows where it is any more."""
        self.referenced = dict.fromkeys(self.referenced, False)
