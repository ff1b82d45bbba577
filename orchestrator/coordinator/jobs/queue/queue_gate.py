"""The queue as a whole: stopped or started. While it is stopped no waiting job begins.

Nothing begins by itself after a break: a restart of the fleet, an interrupted step, a controller that was off,
restarted or unreferenced meanwhile. A break stops the queue if jobs wait; a stop or an e-stop always does. Only
`tutti queue start` starts it. Another leader is no break if the controllers did not notice the change.
"""

from collections.abc import Callable

from orchestrator.coordinator.jobs.queue.journal_tasks import JournalTasks
from orchestrator.coordinator.jobs.queue.publisher import QueuePublisher
from orchestrator.coordinator.jobs.queue.register import JobRegister
from orchestrator.coordinator.jobs.services import JobServices
from orchestrator.model.queue import QueueStop
from orchestrator.model.state import ControllerState

COORDINATOR = "coordinator"


class QueueGate:
    """Stops and starts the queue, in the journal, and detects breaks."""

    def __init__(self, services: JobServices, register: JobRegister, publisher: QueuePublisher) -> None:
        self._services = services
        self._register = register
        self._publisher = publisher
        self._instances: dict[str, str] = {}
        self._referenced: dict[str, set[str]] = {}
        self._tasks = JournalTasks(services, "the state of the queue is not recorded: ")
        self._remove_listener: Callable[[], None] = lambda: None

    async def start(self, *, interrupted: bool) -> None:
        """Load the state of the queue, and begin to detect breaks. interrupted: the last leader left a job running.

        Raises `JournalError`.
        """
        journal, execute = self._services.journal, self._services.execute
        self._register.stopped = await execute(journal.load_queue_stop)
        self._instances = await execute(journal.load_instances)
        if interrupted:
            self.note_break("a job was interrupted when the coordinator ended")
        view = self._services.view
        self._remove_listener = view.add_state_listener(self._check_state)
        for controller in view.fleet.controllers:
            state = view.last_state(controller)
            if state is not None:
                self._check_state(state)

    def close(self) -> None:
        self._remove_listener()
        self._tasks.cancel_all()

    def note_break(self, reason: str) -> None:
        """Stop the queue because of a break, if jobs wait and the fleet file does not let the queue continue."""
        if self._services.view.fleet.queue.on_restart == "stop" and self._register.count_unattended():
            self.stop_queue(reason, COORDINATOR)

    def stop_queue(self, reason: str, actor: str) -> None:
        """Stop the queue now, and record it. The first reason stays."""
        if self._register.stopped is not None:
            return
        self._register.stopped = QueueStop(reason=reason, actor=actor, utc=self._services.clock.utc())
        self._services.log.warning(f"the queue is stopped: {reason}")
        self._tasks.spawn(self._store, self._register.stopped)
        self._publisher.note_change()

    async def start_queue(self, actor: str) -> None:
        """Start the queue. Raises `JournalError`; then it stays stopped."""
        await self._services.execute(self._services.journal.store_queue_stop, None)
        if self._register.stopped is not None:
            self._register.stopped = None
            self._services.log.info(f"the queue is started by {actor}")
        self._publisher.note_change()

    # Breaks

    def _check_state(self, state: ControllerState) -> None:
        """Compare the state of a controller with the one before: has it been off, restarted or unreferenced?"""
        name = state.controller
        if self._instances.get(name) != state.instance:
            self._instances[name] = state.instance
            self._referenced.pop(name, None)
            self._tasks.spawn(self._store_instances)
            self.note_break(f"restart: the adapter of {name} has started again")
        if state.mode == "offline":
            # An adapter that has just started is offline until it has reached its controller.
            if name in self._referenced:
                self.note_break(f"{name} is offline")
            self._referenced.pop(name, None)
            return
        # A search for the reference is an order, not a loss.
        known_axes = {axis for axis, axis_now in state.axes.items() if axis_now.referenced and not axis_now.homing}
        searching = {axis for axis, axis_now in state.axes.items() if axis_now.homing}
        lost_axes = self._referenced.get(name, set()) - known_axes - searching
        self._referenced[name] = known_axes
        if lost_axes:
            self.note_break(f"{name}.{min(lost_axes)} is no longer referenced")

    async def _store(self, stop: QueueStop) -> None:
        await self._services.execute(self._services.journal.store_queue_stop, stop)

    async def _store_instances(self) -> None:
        await self._services.execute(self._services.journal.store_instances, dict(self._instances))
