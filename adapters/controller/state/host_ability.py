"""How far an axis goes on when its host stops it by an input."""

from adapters.abilities import ManualDriver
from adapters.contract import Driver
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.fleet import Controller
from orchestrator.model.state import HOST_RAMP_SHARE, INPUT_S, ProbeAbility

WATCH_NS = 200 * NS_PER_MS
"""The longest time from the beginning of a poll that shows the input as before to the writing of the stop: a poll that
takes longer ends the probe."""
READ_COUNTS = 1.0  # by which a position is rounded when it is read
REST_COUNTS = 2.0


def find_host_ability(driver: Driver, config: Controller) -> ProbeAbility | None:
    """How this computer stops axes by inputs; None for a make that cannot jog."""
    if not isinstance(driver, ManualDriver):
        return None
    lead_s = driver.capabilities.costs.find_stop_lead_s(config.full_ramps_s)
    numbers = [point.number for point in config.inputs.values()]
    return ProbeAbility(
        inputs=dict.fromkeys(config.axes, numbers),
        levels=["active", "passive"],
        reaction_s=WATCH_NS / NS_PER_S + lead_s,
        ramp_share=HOST_RAMP_SHARE,
        margin_counts=READ_COUNTS + REST_COUNTS,
        contact_s=INPUT_S,
        contact_counts=READ_COUNTS,
    )
