"""home: the procedure that its option string describes (L2039-L2110)."""

from dataclasses import dataclass, replace
from fractions import Fraction

from sim.ppsmc.axis import StepperAxis
from sim.ppsmc.grammar import InputRefused, parse_decimal, parse_integer
from sim.ppsmc.legs import MotionLeg, Steps
from sim.ppsmc.moves import search_profile
from sim.ppsmc.path import jog_path
from sim.ppsmc.sensors import TravelSwitch, UntilSwitch, limit_switch

_MOST_HZ = 2_457_000
_SWITCHES = {"hs": TravelSwitch.ORG, "hsd": TravelSwitch.SD, "he": TravelSwitch.INDEX}


@dataclass(frozen=True, slots=True)
class HomingProcedure:
    """Homing parameters. Speeds are Hz; `free` is the direction in which the home switch is run free, 0: it is not."""

    switch: TravelSwitch | None = None
    seek: int = 0
    """Direction in which a limit switch is searched first; 0: none."""
    seek_hz: int | None = None
    slow_hz: int | None = None
    free: int = 0
    position: Fraction | None = None

    @property
    def has_motion(self) -> bool:
        return bool(self.seek or self.switch is not None or self.free)


def read_homing(text: str) -> HomingProcedure:
    """Parse options separated by `;`, in any case. Raises `InputRefused`."""
    homing = HomingProcedure()
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
            homing = replace(homing, seek=seek, seek_hz=parse_integer(digits, 1, _MOST_HZ) if digits else None)
        elif name in ("vl", "v"):
            homing = replace(homing, slow_hz=parse_integer(value, 1, _MOST_HZ))
        elif name in ("hm", "hr"):
            position = parse_decimal(value) if value else Fraction(0)
            homing = replace(homing, free=1 if name == "hm" else -1, position=position)
        else:
            raise InputRefused(f"unknown homing option '{part}'")
    return homing


def homing_steps(axis: StepperAxis, homing: HomingProcedure) -> Steps:
    """Search the limit switch and back off it; search the home switch in the other direction; run free; set the
    position (decision 17).

    Without jg the home switch is searched in negative direction, or against the direction of running free.
    """
    profile = axis.settings.speed_profile
    base = replace(profile, slew=profile.start)
    slow = base if homing.slow_hz is None else replace(profile, slew=float(homing.slow_hz))
    sign = homing.seek
    if sign:
        fast = base if homing.seek_hz is None else replace(profile, slew=float(homing.seek_hz))
        yield MotionLeg(jog_path(sign, fast), fast, seeks_limit=True)
        yield MotionLeg(jog_path(-sign, slow), slow, until=UntilSwitch(limit_switch(sign), on=False))
    if homing.switch is not None:
        search = search_profile(axis, base)
        direction = -sign or -homing.free or -1
        yield MotionLeg(jog_path(direction, search), search, until=UntilSwitch(homing.switch, on=True))
        if homing.free and homing.switch is not TravelSwitch.INDEX:
            yield MotionLeg(jog_path(homing.free, slow), slow, until=UntilSwitch(homing.switch, on=False))
        axis.index_found = axis.index_found or homing.switch is TravelSwitch.INDEX
    position = axis.settings.rofs
    if homing.position is not None and homing.switch is not TravelSwitch.INDEX:
        position = homing.position
    if homing.switch is not None or homing.position is not None or not homing.has_motion:
        axis.set_counter(axis.count_steps(position))
        axis.referenced = axis.homed = True
