"""What kinds of steps may be checked against zones."""

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.steps.base import Step
from orchestrator.model.zone_problems import list_zone_axes


def require_swept(fleet: Fleet, step: Step) -> None:
    """Raise `Refusal` (code `zone`) for a step of a kind that moves axes of zones, and does not say where."""
    if fleet.zones is None or not step.moves or step.is_swept:
        return
    bound_axes = [name for name in list_zone_axes(fleet.zones, fleet) if name in step.find_axes(fleet)]
    if bound_axes:
        text = f"{', '.join(bound_axes)} moves bodies of zones, and where `do: {step.kind}` may lead it is not known"
        raise Refusal("zone", text, "move these axes by other steps")
