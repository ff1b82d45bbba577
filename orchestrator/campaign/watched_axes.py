"""What watches the true motions of axes while a phase of the campaign runs, and checks them after it."""

from collections.abc import Callable, Mapping, Sequence

from orchestrator.campaign.contact_checks import ContactChecker
from orchestrator.campaign.flight_checks import FlightChecker
from orchestrator.campaign.rack_checks import RackChecker
from orchestrator.campaign.recording.recorder import BusRecorder, RecordedRequest
from orchestrator.campaign.records import CampaignPhase, PhaseRecords, StepRecord
from orchestrator.campaign.triggers import TriggerChecker
from orchestrator.campaign.virtual_lines import VirtualLineChecker
from orchestrator.campaign.zone_checks import ZoneChecker
from orchestrator.model.report import JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet


class WatchedAxes:
    """The checkers of one fleet that need truth from during a run. seed: of the contacts that axes run into.
    add_violation: called with the invariant and a text."""

    def __init__(
        self,
        fleet: VirtualFleet,
        recorder: BusRecorder,
        records: PhaseRecords,
        seed: int,
        add_violation: Callable[[str, str], None],
    ) -> None:
        self._triggers = TriggerChecker(fleet, records, add_violation)
        self._flights = FlightChecker(fleet, recorder.rows, records, add_violation)
        self._virtual_lines = VirtualLineChecker(fleet, records, add_violation)
        self._racks = RackChecker(fleet, add_violation)
        self._zones = ZoneChecker(fleet, add_violation)
        self._contacts = ContactChecker(fleet, seed, records, add_violation)

    def watch(self, phase: CampaignPhase) -> None:
        """Watch axes that fly, virtual axes, pairs and zones in a phase's jobs from now on."""
        self._flights.watch(phase)
        self._virtual_lines.watch(phase)
        self._racks.watch()
        self._zones.watch(phase)

    def end(self) -> None:
        """Watch no more."""
        self._flights.end()
        self._virtual_lines.end()
        self._racks.end()
        self._zones.end()

    def note_request(self, request: RecordedRequest) -> None:
        """Put a contact in front of an axis that shall probe."""
        self._contacts.note_request(request)

    def check_phase(
        self,
        phase: CampaignPhase,
        steps: Sequence[StepRecord],
        reports: Mapping[str, JobReport | None],
        untrusted: set[str],
    ) -> None:
        """Check invariants 16, 18, 19, 20, 22 and 23 for a phase. untrusted: controllers whose links and crystals are
        outside the model."""
        self._flights.check_phase(phase, self._triggers.rises, untrusted)
        self._virtual_lines.check_phase(phase, reports, untrusted)
        self._racks.check_phase(phase, steps, reports)
        self._zones.check_phase(phase, reports)
        self._contacts.check_phase(phase, steps, reports, untrusted)
        self._triggers.check_phase(phase, steps, reports, untrusted)
