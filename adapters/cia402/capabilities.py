"""What a drive supports, by whether it follows positions of this computer."""

from adapters.contract import DriverCapabilities
from orchestrator.model.state import StepCosts

LONGEST_CHUNK_S, LOAD_S = 60.0, 0.1  # nothing is loaded ahead in the drive
RETARGET_PERIODS = 10  # those that are sent ahead, and some for the request


def make_capabilities(costs: StepCosts, period_ms: int | None) -> DriverCapabilities:
    """What a drive supports. period_ms: of the positions that it follows; None: it follows none."""
    if period_ms is None:
        return DriverCapabilities(start_classes=("sync",), orders=(2,), independent_axes=False, costs=costs)
    return DriverCapabilities(
        start_classes=("sync",),
        orders=(2, 3),
        independent_axes=False,
        costs=costs,
        chunk_s=LONGEST_CHUNK_S,
        chunk_load_s=LOAD_S,
        retarget_s=RETARGET_PERIODS * period_ms / 1000,
    )
