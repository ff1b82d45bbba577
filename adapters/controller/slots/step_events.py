"""Events of steps: published at once, and followed by a poll."""

from collections.abc import Mapping

from adapters.controller.publishing.publisher import StatePublisher
from adapters.controller.state.armed_step import ArmedStep
from adapters.controller.state.poll_timer import PollTimer
from orchestrator.model.state import AxisEvidence, EventKind


class StepEvents:
    """Publishes the events of the steps of one controller."""

    def __init__(self, publisher: StatePublisher, timer: PollTimer) -> None:
        self._publisher = publisher
        self._timer = timer

    def emit_step(
        self, kind: EventKind, text: str, armed_step: ArmedStep, evidence: Mapping[str, AxisEvidence] | None = None
    ) -> None:
        """Publish an event of a step."""
        self._publisher.emit_event(kind, text, armed_step=armed_step, evidence=evidence)
        self._timer.wake_up()

    def publish_state(self) -> None:
        """Publish the state."""
        self._publisher.publish_state()
