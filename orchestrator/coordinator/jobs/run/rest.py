"""Rest of a job's controllers: motion of an earlier holder, or of a stop, has ended."""

from contextlib import suppress

from orchestrator.bus.base import BusError
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.clock.owner import call_for_each
from orchestrator.coordinator.jobs.needs import find_axes
from orchestrator.coordinator.jobs.run.sequence import StepSequence
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.names import controller_of
from orchestrator.model.steps.tree import iterate_steps

REST_NS = NS_PER_S // 2  # beyond a declared stop time, for a poll to show rest
REST_POLL_NS = NS_PER_S // 20


class RestMonitor:
    """Waits for the rest of the controllers that the steps from number `first` on move or switch.

    seen_ns: since when they have been at rest without any request; None: not known.
    """

    def __init__(self, services: JobServices, steps: StepSequence, first: int) -> None:
        self.seen_ns: int | None = None
        self._services = services
        self._steps = steps
        self._first = first

    @property
    def members(self) -> list[str]:
        """Controllers that it can move, or whose outputs it switches on the way, to stop them all."""
        steps = self._steps.list_steps(self._first)
        moved_controller = group_by_controller(find_axes(self._services.view.fleet, steps))
        outputs = [output for step in iterate_steps(steps) for output in step.trigger_outputs]
        return list(dict.fromkeys([*moved_controller, *map(controller_of, outputs)]))

    async def wait_for_rest(self, since_ns: int | None = None) -> None:
        """Wait until motion that was stopped, by this job or an earlier leader or holder, has come to rest. A member
        that does not answer, or takes longer than it has declared, is waited for only that long: planning refuses
        it. since_ns: answers count from then on."""
        self.seen_ns = self._services.clock.now_ns() if since_ns is None else since_ns
        await call_for_each(lambda member: self._wait_for_member_rest(member, since_ns), self.members)

    async def _wait_for_member_rest(self, member: str, since_ns: int | None) -> None:
        services = self._services
        # The ramps of a step may be gentler than the limits of its axes.
        stop_ns = services.motion.stop_times_ns.get(member, 0)
        with suppress(BusError):
            stop_ns = max(stop_ns, (await services.view.infos.query(member)).costs.stop_ns)
        until_ns = services.clock.now_ns() + stop_ns + REST_NS
        while services.clock.now_ns() < until_ns:
            # A member that does not answer is stopped by its guardian or its own watchdog, which takes as long.
            with suppress(BusError):
                state, since_ns = await services.view.query_state(member, since_ns), None
                # A homing that has just begun is not seen as motion yet.
                busy = any(axis.moving or axis.homing for axis in state.axes.values())
                if state.mode not in ("moving", "stopping") and not busy:
                    return
            await sleep_ns(services.clock, REST_POLL_NS)
