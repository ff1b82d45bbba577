"""Which controllers of a virtual fleet are at rest, by the simulators themselves."""

from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.clock.virtual import VirtualClock
from orchestrator.runtime.virtual.fleet import VirtualFleet

POLLS, POLL_NS = 150, 7 * NS_PER_MS


async def find_at_rest(fleet: VirtualFleet, clock: VirtualClock) -> set[str]:
    """Return the controllers at rest, or that come to rest within a second. One that decodes a poll at this moment is
    not at rest for a while: it is checked repeatedly."""
    resting: set[str] = set()
    for _ in range(POLLS):
        resting |= {name for name, controller in fleet.controllers.items() if controller.at_rest()}
        if len(resting) == len(fleet.controllers):
            break
        await sleep_ns(clock, POLL_NS)
    return resting
