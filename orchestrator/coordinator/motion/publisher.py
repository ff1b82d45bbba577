"""What the steps of a job publish for those that record it: plans, positions that controllers have sampled, edges."""

from dataclasses import dataclass

from orchestrator.bus.base import Bus, Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.model.operation.recording import RecordedTriggers, StepSamples
from orchestrator.model.report import StepRecording


@dataclass(frozen=True, slots=True)
class StepPublisher:
    """Publishes what a step of a job leaves, after the step."""

    bus: Bus
    keys: FleetKeys

    def publish_plan(self, job_id: str, recording: StepRecording) -> None:
        """Publish the plan of a step; the positions polled are published as states."""
        axes = {name: axis.model_copy(update={"sampled": []}) for name, axis in recording.axes.items()}
        plan = recording.model_copy(update={"axes": axes})
        self.bus.put(self.keys.job_plan(job_id), plan.to_json(), Priority.EVENT)

    def publish_samples(self, samples: StepSamples) -> None:
        """Publish what a controller has sampled during a step."""
        self.bus.put(self.keys.job_samples(samples.job_id), samples.to_json(), Priority.EVENT)

    def publish_triggers(self, triggers: RecordedTriggers) -> None:
        """Publish what an output did on the way of a step."""
        self.bus.put(self.keys.job_triggers(triggers.job_id), triggers.to_json(), Priority.EVENT)
