"""home: the procedure that its option string describes (L2039-L2110)."""

from dataclasses import dataclass, replace
from fractions import Fraction

from sim.ppsmc.axis import Axis
from sim.ppsmc.grammar import Refused, decimal, integer
from sim.ppsmc.moves import slowing
from sim.ppsmc.path import jog
from sim.ppsmc.sensors import Switch, Until, limit_of
from sim.ppsmc.task import Leg, Steps

_MOST_HZ = 2_457_000
_SWITCHES = {"hs": Switch.ORG, "hsd": Switch.SD, "he": Switch.INDEX}


@dataclass(frozen=True, slots=True)
class Homing:
    """What to do. Speeds are Hz; `free` is the direction in which the home switch is run free, 0: it is not."""

    switch: Switch | None = None
    seek: int = 0
    """Direction in which a limit switch is sought first; 0: none is."""
    seek_hz: int | None = None
    slow_hz: int | None = None
    free: int = 0
    position: Fraction | None = None

    @property
    def moves(self) -> bool:
        return bool(self.seek or self.switch is not None or self.free)


def read_homing(text: str) -> Homing:
    """Options separated by `;`, in any case. Raises `Refused`."""
    homing = Homing()
    for part in text.lower().replace(" ", "").split(";"):
        name = part.rstrip("0123456789.+-")
        value = part[len(name) :]
        if not part:
            continue
        if name in _SWITCHES and not value:
            homing = replace(homing, switch=_SWITCHES[name])
        elif name == "jg":
            seek = -1 if value.startswith("-") else 1
            digits = value.lstrip("+-")
            homing = replace(homing, seek=seek, seek_hz=integer(digits, 1, _MOST_HZ) if digits else None)
        elif name in ("vl", "v"):
            homing = replace(homing, slow_hz=integer(value, 1, _MOST_HZ))
        elif name in ("hm", "hr"):
            position = decimal(value) if value else Fraction(0)
            homing = replace(homing, free=1 if name == "hm" else -1, position=position)
        else:
            raise Refused(f"unknown homing option '{part}'")
    return homing


def home(axis: Axis, homing: Homing) -> Steps:
    """Limit switch and back off it; home switch in the other direction; run free; take the position (decision 17).

    Without jg the home switch is sought in negative direction, or against the direction of running free.
    """
    profile = axis.settings.profile
    base = replace(profile, slew=profile.start)
    slow = base if homing.slow_hz is None else replace(profile, slew=float(homing.slow_hz))
    sign = homing.seek
    if sign:
        fast = base if homing.seek_hz is None else replace(profile, slew=float(homing.seek_hz))
        yield Leg(jog(sign, fast), fast, seeks_limit=True)
        yield Leg(jog(-sign, slow), slow, until=Until(limit_of(sign), False))
    if homing.switch is not None:
        search = slowing(axis, base)
        way = -sign or -homing.free or -1
        yield Leg(jog(way, search), search, until=Until(homing.switch, True))
        if homing.free and homing.switch is not Switch.INDEX:
            yield Leg(jog(homing.free, slow), slow, until=Until(homing.switch, False))
        axis.index_found = axis.index_found or homing.switch is Switch.INDEX
    position = axis.settings.rofs
    if homing.position is not None and homing.switch is not Switch.INDEX:
        position = homing.position
    if homing.switch is not None or homing.position is not None or not homing.moves:
        axis.set_counter(axis.count(position))
        axis.referenced = axis.homed = True
