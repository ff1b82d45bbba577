"""What the probes of a job have measured, for its later steps."""

from fractions import Fraction

from orchestrator.coordinator.fleet.axis_states import require_axis
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.errors import Refusal
from orchestrator.model.names import controller_of
from orchestrator.model.report import ProbeReport, StepReport
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.measured import MeasuredTarget
from orchestrator.model.units import Quantity, UnitError, parse_quantity


class MeasuredContacts:
    """The contacts of one job, by the names that later steps use. A later probe of the same name replaces one."""

    def __init__(self, view: FleetView) -> None:
        self._view = view
        self._probes: dict[str, ProbeReport] = {}

    def take_report(self, step: Step, report: StepReport) -> None:
        """Keep what a step has measured."""
        axis_reports = {probe.axis: probe for probe in report.probed_axes}
        names = step.contact_names.items()
        self._probes |= {name: axis_reports[axis] for name, axis in names if axis in axis_reports}

    async def fill_measured(self, step: Step) -> Step:
        """The step with quantities for what was measured, as user positions of now: a contact is a place of the
        machine, also where the user's zero was moved since. Raises `Refusal`."""
        targets = step.measured_targets
        if not targets:
            return step
        return step.with_measured({axis: await self._find_position(axis, target) for axis, target in targets.items()})

    async def _find_position(self, axis: str, target: MeasuredTarget) -> Quantity:
        unit, controller = self._view.fleet.axis(axis).unit, controller_of(axis)
        offset = (await require_axis(self._view, axis)).offset
        motors = [self._find_contact(name).motor for name in target.of]
        try:
            position = sum(motors, Fraction(0)) / len(motors) + offset + parse_quantity(target.plus, unit)
            bounds = [parse_quantity(bound, unit) for bound in target.between or ()]
        except UnitError as error:
            raise Refusal("bad-unit", f"{axis}: {error}", "correct the unit", controller) from None
        if bounds and not min(bounds) <= position <= max(bounds):
            text = (
                f"{target.describe()} is at {float(position):.9g} {unit} of {axis}, and not between "
                f"{float(min(bounds)):g} and {float(max(bounds)):g}"
            )
            raise Refusal("measured-bounds", text, "look what was touched; then correct `between`", controller)
        return f"{float(position):.15g} {unit}"

    def _find_contact(self, name: str) -> ProbeReport:
        report = self._probes.get(name)
        if report is None:
            text = f"{name} has not been measured in this job"
            raise Refusal("not-measured", text, "begin the job with its probe")
        if not report.touched:
            text = f"{name} is not known: {report.until} was not touched"
            raise Refusal("not-measured", text, "probe farther, or with `else: fail`")
        return report
