"""Speeds and ramps in host time as the controller's registers: whole steps in its own samples, rounded down.

The controller counts in samples, so that the meaning of a register in host time depends on its crystal and on TM
(L10749-10763).
"""

from adapters.yaskawa.shapes.model import RAMP_UNIT, SMC4000, SPEED_UNIT, ModelTraits
from orchestrator.model.errors import Refusal


def speed_register(counts_s: float, tick_s: float, model: ModelTraits = SMC4000) -> int:
    """Return SP or JG for a speed in host time, rounded as the controller does (L10032); 0 when the speed is too
    low."""
    return min(model.speed_max, int(counts_s * tick_s * SPEED_UNIT // model.speed_step) * model.speed_step)


def ramp_register(counts_s2: float, tick_s: float, model: ModelTraits = SMC4000) -> int:
    """Return AC or DC for an acceleration in host time (L2294); 0 when it is too low."""
    return min(model.ramp_max, int(counts_s2 * tick_s**2 * RAMP_UNIT // model.ramp_step) * model.ramp_step)


def exact_speed(axis: str, counts_s: float, tick_s: float, model: ModelTraits = SMC4000) -> int:
    """Like `speed_register`, but raise `Refusal` with what would fit instead of returning 0."""
    register = speed_register(counts_s, tick_s, model)
    if not register:
        least = model.speed_step / SPEED_UNIT / tick_s
        raise Refusal(
            "too-slow",
            f"axis {axis}: {counts_s:g} counts/s is below the controller's lowest speed",
            f"at least {least:g} counts/s",
        )
    return register


def exact_ramp(axis: str, counts_s2: float, tick_s: float, model: ModelTraits = SMC4000) -> int:
    """Like `ramp_register`, but raise `Refusal` with what would fit instead of returning 0."""
    register = ramp_register(counts_s2, tick_s, model)
    if not register:
        least = model.ramp_step / RAMP_UNIT / tick_s**2
        raise Refusal(
            "too-gentle",
            f"axis {axis}: a ramp of {counts_s2:g} counts/s² is below the controller's lowest ramp",
            f"at least {least:g} counts/s²",
        )
    return register
