"""What was learned of the times of the fleet outlives the coordinator: its lead times, kept in the journal.

They are used again for a controller whose configuration is the same, for thirty days. They shorten what is waited for,
and no bound of a start: a member that is late all the same is armed again, as with times that were never learned.
"""

from contextlib import suppress
from datetime import datetime, timedelta
from hashlib import sha256

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.fleet.listening import keep_apart
from orchestrator.coordinator.fleet.positions import JournalCalls
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.coordinator.journal.store import LearnedStore
from orchestrator.coordinator.motion.lead_time import KNOWN_AFTER, LeadTimeEstimator
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.messages import Reply
from orchestrator.model.operation.learned import FLEET, ForgetTimes, LearnedTimes
from orchestrator.model.report import StepRecording, StepReport

KEPT = timedelta(days=30)
SAVE_STEPS = KNOWN_AFTER
SAVE_NS = 60 * NS_PER_S  # least time between two writes


class LearnedTimesKeeper:
    """Keeps the lead times of `estimator`."""

    def __init__(
        self, access: FleetAccess, estimator: LeadTimeEstimator, store: LearnedStore, execute: JournalCalls
    ) -> None:
        self._access = access
        self._estimator = estimator
        self._store = store
        self._execute = execute
        self._steps = 0
        self._saved_ns: int | None = None
        self.take_motion = keep_apart(access.tasks, self._take_motion)

    async def start(self) -> None:
        """Use what was learned before, as far as it holds. Raises `JournalError`."""
        start = datetime.fromisoformat(self._access.clock.utc())
        for times in await self._execute(self._store.load_times):
            is_fresh = timedelta(0) <= start - datetime.fromisoformat(times.utc) <= KEPT
            if is_fresh and times.digest == self._find_digest(times.controller):
                self._estimator.take_learned(times.controller, times.shares, times.durations_ns)

    async def close(self) -> None:
        """Keep what was learned until now."""
        await self._save()

    async def forget_times(self, request: ForgetTimes) -> Reply:
        """Forget the times of controllers, here and in the journal. Raises `JournalError`, `Refusal` for a controller
        that the fleet does not have."""
        names = self._access.view.fleet.controllers
        for controller in request.controllers:
            if controller not in names:
                known_names = ", ".join(list(names)[:20])
                raise Refusal("unknown-controller", f"there is no controller {controller!r}", f"one of {known_names}")
        controllers = request.controllers or [FLEET, *names]
        for controller in controllers:
            self._estimator.forget_learned(controller)
        await self._execute(self._store.forget_times, controllers)
        return Reply()

    def _take_motion(self, recording: StepRecording, report: StepReport | None) -> None:
        del recording, report
        self._steps += 1
        now_ns = self._access.clock.now_ns()
        if self._steps >= SAVE_STEPS and (self._saved_ns is None or now_ns - self._saved_ns >= SAVE_NS):
            self._steps, self._saved_ns = 0, now_ns
            self._access.tasks.spawn(self._save(), vital=False)

    async def _save(self) -> None:
        """Write what was learned; what a journal does not take is learned again."""
        utc = self._access.clock.utc()
        times = [
            LearnedTimes(
                controller=controller,
                digest=self._find_digest(controller),
                utc=utc,
                shares=self._estimator.list_shares(controller),
                durations_ns=self._estimator.list_durations() if controller == FLEET else {},
            )
            for controller in (FLEET, *self._access.view.fleet.controllers)
        ]
        learned_times = [entry for entry in times if entry.shares or entry.durations_ns]
        if learned_times:
            with suppress(JournalError):
                await self._execute(self._store.save_times, learned_times)

    def _find_digest(self, controller: str) -> str:
        return find_learned_digest(self._access.view.fleet, controller)


def find_learned_digest(fleet: Fleet, controller: str) -> str:
    """The digest of the configuration of a controller, or of all (`FLEET`), by which learned times are known; empty for
    one that the fleet does not have."""
    controllers = fleet.controllers
    if controller != FLEET:
        config = controllers.get(controller)
        return "" if config is None else config.digest
    digests = "\n".join(f"{name} {config.digest}" for name, config in sorted(controllers.items()))
    return sha256(digests.encode()).hexdigest()
