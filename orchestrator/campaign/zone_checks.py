"""Keep-out zones in the fault campaign: by truth, no rule is broken, and a refusal names a way out."""

from collections.abc import Callable, Mapping

from orchestrator.campaign.jobs import JobOrder
from orchestrator.campaign.records import CampaignPhase
from orchestrator.campaign.stages.zone_truth import TRUTH, ZoneTruth
from orchestrator.campaign.stages.zones import SWAP, TOO_FAR
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.owner import TaskOwner
from orchestrator.coordinator.fleet.zone_reservations import ZONE_BUSY
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import RefusalDetails
from orchestrator.model.report import JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet

MOVES_AGAINST_CONTROLLERS = ("stall",)
"""Faults behind which an axis is not where its controller has it."""
_ZONE_CODES = ("zone", ZONE_BUSY)


class ZoneChecker:
    """Watches the zones of a fleet while jobs run. add_violation: called with the invariant and a text."""

    def __init__(self, fleet: VirtualFleet, add_violation: Callable[[str, str], None]) -> None:
        self._fleet = fleet
        self._add_violation = add_violation
        self._truth: ZoneTruth | None = None
        self._tasks = TaskOwner()

    # During a run

    def watch(self, phase: CampaignPhase) -> None:
        """Watch all bodies from now on; does nothing if they are watched, or there are none."""
        if self._fleet.fleet.zones is not None and self._truth is None:
            self._truth = ZoneTruth(self._fleet)
            self._tasks.spawn(self._truth.watch())
        if phase.fault.name in MOVES_AGAINST_CONTROLLERS and phase.fault_ns is not None:
            self.end()

    def end(self) -> None:
        """Watch no more."""
        self._tasks.cancel_all()

    # After a phase

    def check_phase(self, phase: CampaignPhase, reports: Mapping[str, JobReport | None]) -> None:
        """Check invariant 23 until now, and that each refusal of a phase for a zone names a way out."""
        truth = self._truth
        if truth is None:
            return
        for rule, gap in truth.nearest.items():
            if gap < -TRUTH:
                at_s = truth.nearest_ns[rule] / NS_PER_S
                moment = f"at {at_s:.3f} s ({phase.fault.name} of {phase.member})"
                self._add_violation("23", f"zone {rule} was broken by {-gap:.3f} {moment}")
        for job_id, order in phase.jobs.items():
            refusal = find_zone_refusal(reports.get(job_id))
            if refusal is not None and not refusal.remedy:
                self._add_violation("23", f"job {order.job.name} was refused without a way out: {refusal.text}")
            row = self._fleet.journal.load_record(job_id)
            if order.job.name == TOO_FAR and row is not None and row.state == "done":
                self._add_violation("23", f"job {order.job.name} is done, which is within the margins of a zone")


def find_zone_refusal(report: JobReport | None) -> RefusalDetails | None:
    """Why a zone has refused a step of a job; None: none has."""
    refusals = (step.refused for step in report.steps if step.refused is not None) if report is not None else ()
    return next((refusal for refusal in refusals if refusal.code in _ZONE_CODES), None)


def ends_at_a_zone(report: JobReport | None, reason: str) -> bool:
    """Whether a job was ended by a zone: a step was refused, or stopped by the watch. reason: that of its end."""
    return find_zone_refusal(report) is not None or ": zone " in reason


def may_be_refused(phase: CampaignPhase, order: JobOrder) -> bool:
    """Whether a zone may refuse a step of a job: of both carriages or too far out, beside an axis that is jogged, and
    behind a fault, which has left an axis in its way or without a reference."""
    is_broken = phase.fault_ns is not None and not phase.fault.harmless
    return order.job.name in (SWAP, TOO_FAR) or bool(phase.jogs) or is_broken


def may_refuse_submission(order: JobOrder, refusal: Refusal) -> bool:
    """Whether a zone may refuse a job as it is submitted: for what does not depend on where axes are by then."""
    return refusal.code == "zone" and order.job.name in (SWAP, TOO_FAR)
