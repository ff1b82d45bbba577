"""What the fleets of the fault campaign have besides axes, and what it has to know of their makes."""

from sim.core.campaign import CampaignTraits, campaign_traits
from sim.core.vectors import find_simulator

TRIGGER_OUTPUT, TRIGGER_NUMBER = "flash", 3
"""The output of the controllers whose make has triggers, and its number."""
TRIGGER_PERIOD = "40 ms"
VIRTUAL_GROUP = "table"
"""The virtual axes of a fleet that has some: one for each controller, of its first axis."""
TOUCH_INPUT = "touch"
"""The input that stops an axis that probes."""
PROBE_NAME = "edge"
PAIR_GROUP = "beam"
"""The pair of a fleet that has one."""


def find_traits(make: str) -> CampaignTraits:
    """Return what the campaign has to know of a make."""
    return campaign_traits(find_simulator(make))
