"""What an output has switched in a motion that is still under way: fetched from its owner part by part."""

from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.step import PlannedMotion
from orchestrator.coordinator.motion.trigger_rows import ask_chunked_output, make_window_finder
from orchestrator.model.messages import TakeTriggers, TriggerEdges, TriggersTaken
from orchestrator.model.names import split_name

LOOK_S = 1.0
"""An owner that has not answered by then is asked again."""


class TriggerWatch:
    """One output of a motion along a path in chunks, whose owner shows it (`ChunkTriggers.shows`).

    count: how many of its instants are known to have been switched. wrong: the numbers, from 1, of those that were not
    within their promise. Both stay as they are, whatever is known of them later."""

    def __init__(self, services: MotionServices, motion: PlannedMotion, output: str) -> None:
        self.count = 0
        self.wrong = set[int]()
        self.motion = motion
        self._services = services
        self._output = output

    async def look(self) -> None:
        """Fetch what was switched since the last look. Raises nothing: without an answer nothing is known."""
        owner, name = split_name(self._output)
        requests, step = self._services.fleet.requests, self.motion.planned.request
        is_complete = False
        while not is_complete:
            fields = requests.request_fields(step.job.actor)
            request = TakeTriggers(**fields, job=step.job_id, step=step.index, first=self.count, moving=True)
            reply = await requests.request(owner, "take-triggers", request, TriggersTaken, LOOK_S)
            edges = reply.outputs.get(name)
            if reply.refused is not None or edges is None:
                return
            self._add_edges(edges)
            is_complete = not reply.more

    def _add_edges(self, edges: TriggerEdges) -> None:
        feed = self.motion.feed
        if feed is None:
            return
        output = next(
            output for output in feed.triggers.outputs if output.given.trigger.resolved.output == self._output
        )
        asked_output = ask_chunked_output(output)
        find_window = make_window_finder(asked_output, self.motion.agreement, self.motion.start.state)
        t0_ns = self.motion.start.state.t0_fleet_ns
        for earliest_ns, latest_ns in zip(edges.earliest_ns, edges.latest_ns, strict=True):
            if self.count >= len(asked_output.instants_ns):
                return
            planned_ns = t0_ns + asked_output.instants_ns[self.count]
            early_ns, late_ns = find_window(self.count)
            self.count += 1
            if latest_ns < planned_ns + early_ns or earliest_ns > planned_ns + late_ns:
                self.wrong.add(self.count)
