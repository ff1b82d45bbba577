"""Invariant 24 in the fault campaign: a journal in databases, by the truth of what is committed in them."""

from collections.abc import Callable

from orchestrator.campaign.recording.recorder import BusRecorder, RecordedRequest
from orchestrator.campaign.records import CampaignPhase
from orchestrator.coordinator.journal.reads import READS
from orchestrator.coordinator.journal.store import JournalStore
from orchestrator.coordinator.leadership.lease import LeaderLease
from orchestrator.runtime.virtual.databases.site import CommitMoment, DatabaseSite
from orchestrator.runtime.virtual.fleet import VirtualFleet

_RENEW = LeaderLease.renew.__name__
_TAKE = JournalStore.take_epoch.__name__
_NO_WRITES = READS | {_RENEW, _TAKE, LeaderLease.release.__name__, LeaderLease.read_turn.__name__}
_COMMANDS = ("home", "probe", "arm", "commit", "go", "start-at-once")


class JournalChecker:
    """Checks one fleet whose journal is in the databases of a site."""

    def __init__(
        self, fleet: VirtualFleet, site: DatabaseSite, recorder: BusRecorder, add_violation: Callable[[str, str], None]
    ) -> None:
        self._fleet = fleet
        self._site = site
        self._recorder = recorder
        self._add_violation = add_violation
        self._renewed_ns: dict[int, int] = {}
        self.accepted: set[str] = set()
        """Jobs whose acceptance was answered."""
        site.on_commit = self._check_commit

    def check_request(self, request: RecordedRequest) -> None:
        """A coordinator commands only while it holds the lease."""
        epoch = request.fields.get("epoch")
        if request.verb not in _COMMANDS or request.answered_ns is not None or epoch not in self._renewed_ns:
            return
        since_ns = request.sent_ns - self._renewed_ns[epoch]
        if since_ns > self._fleet.fleet.journal.lease:
            text = f"{request.member} was asked to {request.verb} by the leader of epoch {epoch}"
            self._add_violation("24", f"{text}, which has not renewed its lease for {since_ns / 1e9:.1f} s")

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
        ((last,),) = self._site.journal.database.select("SELECT epoch FROM leader")
        facts = set(self._site.facts)
        if _RENEW in facts and epoch == last:
            self._renewed_ns[epoch] = self._fleet.clock.now_ns()
        if _TAKE in facts:
            for job_id in sorted(self.accepted):
                if self._site.journal.load_record(job_id) is None:
                    self._add_violation("24", f"job {job_id} was accepted, and the next leader does not know it")
        if epoch < last and facts - _NO_WRITES:
            text = f"the leader of epoch {epoch} wrote ({', '.join(sorted(facts))})"
            self._add_violation("24", f"{text} after epoch {last} had been taken")
