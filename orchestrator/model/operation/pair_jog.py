"""How pairs are jogged: both axes together, slowly enough for a fault, and `rack` towards 0 only."""

from collections.abc import Sequence

from orchestrator.model.fleet import Fleet
from orchestrator.model.names import split_name
from orchestrator.model.operation.pair_reach import make_fault_reach
from orchestrator.model.operation.virtual_jog import RealJog, VirtualJog, find_jogs
from orchestrator.model.virtual_maps import Pair


def find_pair_jogs(fleet: Fleet, pair: Pair, reals: Sequence[RealJog], apart_s: float) -> dict[str, VirtualJog]:
    """How the axes of a pair are jogged now, by their names in the group. apart_s: see `find_jogs`. Raises `MapError`.

    The middle is jogged while the beam is square enough: so that `rack` stays within `max_deviation`, at a speed at
    which a fault racks the beam by no more than `may_rack`, and `Pair.jog_reach` far at most. Two axes without
    references, of which nothing says that they are square, are jogged all the same: counts of how they came apart begin
    where they stand.
    """
    (middle_name, middle), (rack_name, rack) = (
        (split_name(name)[1], fleet.virtual_axes.find(name)) for name in (pair.middle, pair.rack)
    )
    most = float(pair.max_deviation)
    rack = rack.model_copy(update={"jog": rack.jog.model_copy(update={"deviation": most})})
    virtual_map = fleet.virtual_axes.maps[pair.group]
    jogs = find_jogs(virtual_map, {middle_name: middle, rack_name: rack}, reals, apart_s)
    fastest = make_fault_reach(fleet, pair, {}).find_speed(float(pair.jog_reach))
    slow_jogs = {name: _slow_down(jog, fastest, float(pair.jog_reach)) for name, jog in jogs.items()}
    if not all(real.state.referenced for real in reals):
        return {middle_name: slow_jogs[middle_name]}
    rack_now = virtual_map.observe([real.state.position for real in reals])[1]
    target = virtual_map.observe([real.state.commanded for real in reals])[1]
    inwards = _limit_inwards(slow_jogs[rack_name], pair.rack, target)
    if abs(rack_now) > most:
        return {rack_name: inwards}
    return {middle_name: slow_jogs[middle_name], rack_name: inwards}


def _slow_down(jog: VirtualJog, fastest: float, reach: float) -> VirtualJog:
    """A jog at `fastest` at most, and no farther than `reach`."""
    share = min(1.0, fastest / jog.speed) if jog.speed else 1.0
    off = {name: value * share for name, value in jog.off.items()}
    return jog.model_copy(update={"speed": jog.speed * share, "off": off, "reach": reach})


def _limit_inwards(jog: VirtualJog, name: str, rack: float) -> VirtualJog:
    """A jog of `rack` that ends where the beam is square."""
    low, high = min(-rack, 0.0), max(-rack, 0.0)
    return jog.model_copy(update={"low": low, "high": high, "low_by": name, "high_by": name, "deviations": {}})
