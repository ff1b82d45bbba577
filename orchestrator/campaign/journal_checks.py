"""Invariant 24 in the fault campaign: a journal in databases, by the truth of what is committed in them."""

from collections.abc import Callable

from orchestrator.bus.base import BusSample
from orchestrator.campaign.recording.recorder import BusRecorder
from orchestrator.campaign.records import CampaignPhase
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.journal.reads import READS
from orchestrator.coordinator.journal.store import JournalStore
from orchestrator.coordinator.leadership.lease import HELD_SHARE, LeaderLease
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.runtime.virtual.databases.site import CommitMoment, DatabaseSite
from orchestrator.runtime.virtual.fleet import VirtualFleet

_RENEW = LeaderLease.renew.__name__
_TAKE = JournalStore.take_epoch.__name__
_NO_WRITES = READS | {_RENEW, _TAKE, LeaderLease.release.__name__, LeaderLease.read_turn.__name__}
MACHINES = ("db-a", "db-b", "db-c")
LATENCY_NS = 100 * NS_PER_MS  # of a heartbeat, at most


def give_databases(fleet: VirtualFleet) -> None:
    """Have the journal of a fleet in databases, if it asks for two copies."""
    if fleet.fleet.journal.copies > 1:
        fleet.use_databases(DatabaseSite(MACHINES))


class JournalChecker:
    """Checks one fleet, if its journal is in databases."""

    def __init__(self, fleet: VirtualFleet, recorder: BusRecorder, add_violation: Callable[[str, str], None]) -> None:
        self._fleet = fleet
        self._recorder = recorder
        self._add_violation = add_violation
        self._renewed_ns: dict[int, int] = {}
        self.accepted: set[str] = set()
        """Jobs whose acceptance was answered."""
        if fleet.site is not None:
            fleet.site.on_commit = self._check_commit

    async def start(self) -> None:
        """Follow the heartbeats of leaders, without which what moves stops, and have a coordinator that stands by."""
        if self._fleet.site is not None:
            await self._fleet.make_client("lease-watcher").bus.subscribe(self._fleet.keys.leader, self._check_heartbeat)
            self._fleet.start_coordinator("standby", standby=True)

    def _check_heartbeat(self, sample: BusSample) -> None:
        """A coordinator commands only while it holds the lease, by its share."""
        epoch = LeaderHeartbeat.read_message(sample.payload).epoch
        held_ns = round(HELD_SHARE * self._fleet.fleet.journal.lease) + LATENCY_NS
        since_ns = self._fleet.clock.now_ns() - self._renewed_ns.get(epoch, self._fleet.clock.now_ns())
        if since_ns > held_ns:
            self._add_violation("24", f"epoch {epoch} leads, {since_ns / NS_PER_S:.1f} s behind its last renewal")

    def check_phase(self, phase: CampaignPhase) -> None:
        """No step of a job was started by two leaders."""
        epochs: dict[tuple[str, int], set[int]] = {}
        for go in self._recorder.find_requests("go"):
            if go.job_id in phase.jobs and go.accepted:
                epochs.setdefault(go.step_id, set()).add(go.fields["epoch"])
        for step, leaders in epochs.items():
            if len(leaders) > 1:
                self._add_violation("24", f"step {step} was started in the epochs {sorted(leaders)}")

    def _check_commit(self, moment: CommitMoment, computer: str) -> None:
        if moment != "after":
            return
        epoch = self._fleet.journal_clients[computer].journal.database.epoch
        ((last,),) = self._fleet.journal.database.select("SELECT epoch FROM leader")
        facts = set(self._fleet.site.facts) if self._fleet.site else set[str]()
        if _RENEW in facts and epoch == last:
            self._renewed_ns[epoch] = self._fleet.clock.now_ns()
        if _TAKE in facts:
            for job_id in sorted(self.accepted):
                if self._fleet.journal.load_record(job_id) is None:
                    self._add_violation("24", f"job {job_id} was accepted, and the next leader does not know it")
        if epoch < last and facts - _NO_WRITES:
            text = f"the leader of epoch {epoch} wrote ({', '.join(sorted(facts))})"
            self._add_violation("24", f"{text} after epoch {last} had been taken")
