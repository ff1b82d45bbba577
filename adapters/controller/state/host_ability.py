"""How far an axis goes on when its host stops it by an input."""

from adapters.abilities import ManualDriver
from adapters.contract import Driver
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.fleet import Controller
from orchestrator.model.state import ProbeAbility

WATCH_NS = 200 * NS_PER_MS
"""The longest time from the beginning of a poll that shows the input as before to the writing of the stop: a poll that
takes longer ends the probe."""
INPUT_S = 0.02
"""How much later than its terminal an input of any make is read at most: optocouplers and filters."""
READ_COUNTS = 1.0  # by which a position is rounded when it is read
REST_COUNTS = 2.0


def find_host_ability(driver: Driver, config: Controller) -> ProbeAbility | None:
    """How this computer stops axes by inputs; None for a make that cannot jog."""
    if not isinstance(driver, ManualDriver):
        return None
    # Of the time of a stop, what is not the ramp from full speed is the way to the controller.
    ramps_s = [axis.limits.velocity / axis.limits.acceleration for axis in config.axes.values()]
    write_s = max(0.0, driver.capabilities.costs.stop_ns / NS_PER_S - max(ramps_s))
    numbers = [point.number for point in config.inputs.values()]
    return ProbeAbility(
        inputs=dict.fromkeys(config.axes, numbers),
        levels=["active", "passive"],
        reaction_s=WATCH_NS / NS_PER_S + write_s,
        ramp_share=0.75,
        margin_counts=READ_COUNTS + REST_COUNTS,
        contact_s=INPUT_S,
        contact_counts=READ_COUNTS,
    )
