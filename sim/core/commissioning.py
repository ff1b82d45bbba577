"""How a simulated controller is set up for a machine, as a technician would: from the fleet file.

Each model derives its own options from the controller's part of the file; what the file states under `simulate` has
precedence.
"""

from math import ceil

from orchestrator.model.fleet import Axis

SEARCH_S = 0.5  # from where an axis stands at power-up to its reference, at the speed of the search
SEARCH_OF_LIMIT = 0.1  # speed of the search where the fleet file states none


def search_distance(axis: Axis) -> int:
    """Counts from the position at power-up to the reference switch, so that a search is short at any speed."""
    speed = axis.homing.speed or SEARCH_OF_LIMIT * axis.limits.velocity
    return max(20, ceil(speed * float(axis.scale) * SEARCH_S))


def span_counts(axis: Axis) -> int:
    """Counts between the soft limits; a large number without."""
    limits = axis.soft_limits_counts
    return 1_000_000 if limits is None else limits[1] - limits[0]
