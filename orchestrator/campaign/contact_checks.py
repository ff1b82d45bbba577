"""Probes in the fault campaign: contacts in front of their axes, and by truth how far these go on behind them."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass
from random import Random
from typing import Any

from orchestrator.campaign.recording.recorder import RecordedRequest
from orchestrator.campaign.records import CampaignPhase, PhaseRecords, StepRecord
from orchestrator.campaign.stages.fleet_parts import find_traits
from orchestrator.campaign.stages.probes import find_probe
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.names import split_name
from orchestrator.model.report import JobReport
from orchestrator.runtime.virtual.fleet import VirtualFleet
from sim.core.contact import ContactPlace, PhysicalContact

CONTACT_SHARES = (0.15, 1.1)  # of a probe's way; more than all of it is never touched
MOST_BOUNCES = 2
BOUNCE_MS = (1, 9)
SPREAD_COUNTS = 2  # of the truth: rounding, and what an axis moves between two looks at its contact


@dataclass(slots=True)
class _WatchedProbe:
    """One request to probe, and the contact in front of its first axis. shifts: by axis, physical less reported counts;
    signs: where it goes."""

    request: RecordedRequest
    contact: PhysicalContact
    shifts: Mapping[str, float]
    signs: Mapping[str, int]

    @property
    def terms(self) -> dict[str, Mapping[str, Any]]:
        """What the request says of each axis."""
        return find_terms(self.request)

    def list_made(self, axis: str, motor: str) -> list[float]:
        """Where an axis was at each contact, reported counts."""
        made_contacts, is_first = self.contact.made, axis == next(iter(self.shifts))
        return [
            (contact.counts if is_first else contact.beside[motor]) - self.shifts[axis] for contact in made_contacts
        ]


def find_terms(request: RecordedRequest) -> dict[str, Mapping[str, Any]]:
    """What a request to probe says of each of its axes."""
    fields = request.fields
    return {fields["axes"][0]: fields, **fields.get("line", {})}


class ContactChecker:
    """The contacts of one fleet. add_violation: called with the invariant and a text."""

    def __init__(
        self, fleet: VirtualFleet, seed: int, records: PhaseRecords, add_violation: Callable[[str, str], None]
    ) -> None:
        self._fleet = fleet
        self._draw = Random(f"contacts {seed}")
        self._records = records
        self._add_violation = add_violation
        self._watched: list[_WatchedProbe] = []

    def note_request(self, request: RecordedRequest) -> None:
        """Put a contact in front of the axis that a request shall move, as soon as the request is sent."""
        if request.verb != "probe" or request.answered_ns is not None:
            return
        member, names = request.member, request.fields["axes"]
        config = self._fleet.fleet.controllers[member]
        unit, process = self._fleet.controllers[member], self._fleet.simulators[member]
        motors = {name: config.axes[name].motors[0] for name in names}
        motor = motors[names[0]]
        way = request.fields["end_counts"] - unit.position(motor)
        begin, sign, touch = unit.physical_position(motor), 1 if way >= 0 else -1, find_traits(config.adapter).touch
        assert touch is not None
        bounces_ns = [
            self._draw.randrange(*BOUNCE_MS) * NS_PER_MS for _ in range(2 * self._draw.randrange(MOST_BOUNCES + 1))
        ]
        contact_place = ContactPlace(
            axis=motor,
            at_counts=begin + way * self._draw.uniform(*CONTACT_SHARES),
            side=sign,
            number=touch.number,
            level=touch.active == "high",
            bounces_ns=bounces_ns,
            beside=[motors[name] for name in names[1:]],
        )
        contact = process.run_inside(lambda: PhysicalContact(unit, self._fleet.clock, contact_place))
        shifts = {name: unit.physical_position(axis) - unit.position(axis) for name, axis in motors.items()}
        signs = {
            name: 1 if terms["end_counts"] >= unit.position(motors[name]) else -1
            for name, terms in find_terms(request).items()
        }
        self._watched.append(_WatchedProbe(request, contact, shifts, signs))

    def check_phase(
        self,
        phase: CampaignPhase,
        steps: Sequence[StepRecord],
        reports: Mapping[str, JobReport | None],
        untrusted: Collection[str],
    ) -> None:
        """Check invariants 8 and 20 for the probes of a phase, and remove their contacts. untrusted: controllers whose
        links and crystals are outside the model."""
        for probe in self._watched:
            probe.contact.remove()
            if probe.contact.made and probe.request.member not in untrusted:
                self._check_probe(phase, steps, probe)
                self._check_evidence(reports.get(probe.request.job_id), probe)
        self._watched.clear()

    def _check_probe(self, phase: CampaignPhase, steps: Sequence[StepRecord], probe: _WatchedProbe) -> None:
        member = probe.request.member
        for axis_name, terms in probe.terms.items():
            motor, sign = self._find_motor(member, axis_name), probe.signs[axis_name]
            contact_counts = probe.list_made(axis_name, motor)[0]
            allowed_counts = terms["overtravel_counts"]
            if self._may_reach_end(phase, probe):
                allowed_counts = max(allowed_counts, sign * (terms["end_counts"] - contact_counts))
            for motion in self._fleet.controllers[member].commanded_motions[phase.motions_before[member] :]:
                if motion.axis != motor or motion.end_counts is None:
                    continue
                step = self._records.find_step(member, axis_name, motion, steps)
                if step is None or (step.job, step.index) != probe.request.step_id:
                    continue
                overtravel = sign * (motion.end_counts - contact_counts)
                if overtravel > allowed_counts + SPREAD_COUNTS:
                    text = f"{member}.{axis_name} went on by {overtravel:.1f} counts behind its contact"
                    self._add_violation("20", f"{text}, and {allowed_counts:.1f} were stated")

    def _check_evidence(self, report: JobReport | None, probe: _WatchedProbe) -> None:
        """The places of a contact that a report states contain the true ones."""
        member = probe.request.member
        for step in report.steps if report is not None else []:
            if step.index != probe.request.step_id[1]:
                continue
            for evidence in step.probed_axes:
                if not evidence.touched:
                    continue
                axis_name = split_name(evidence.axis)[1]
                axis = self._fleet.fleet.axis(evidence.axis)
                counts = probe.list_made(axis_name, self._find_motor(member, axis_name))
                positions = [axis.to_unit(count) for count in counts]
                if not any(evidence.least <= position <= evidence.most for position in positions):
                    text = f"{evidence.axis} touched at {positions}, claimed {evidence.least} to {evidence.most}"
                    self._add_violation("8", text)

    def _find_motor(self, member: str, axis_name: str) -> str:
        return self._fleet.fleet.controllers[member].axes[axis_name].motors[0]

    def _may_reach_end(self, phase: CampaignPhase, probe: _WatchedProbe) -> bool:
        """Whether a fault was in the way of the computer that stops the axis."""
        order = phase.jobs.get(probe.request.job_id)
        step = find_probe(order.job) if order is not None else None
        member = probe.request.member
        touch = find_traits(self._fleet.fleet.controllers[member].adapter).touch
        by_controller = touch is not None and touch.stops_by == "controller" and step is not None and step.by != "host"
        return (
            not by_controller and phase.fault_ns is not None and not phase.fault.harmless and member in phase.affected
        )
