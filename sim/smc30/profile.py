"""Trapezoids with a start rate, in closed form: steps and steps/s over seconds of device time."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class _ProfilePiece:
    """Constant acceleration from `begin_s` on, with `steps` completed at `rate`."""

    begin_s: float
    steps: float
    rate: float
    slope: float


@dataclass(frozen=True, slots=True)
class StepProfile:
    """Steps completed (unsigned) as a function of time since its start.

    The k-th step occurs when k steps are complete (decision 14).
    distance: steps at its end, infinite if it has none.
    """

    pieces: tuple[_ProfilePiece, ...]
    end_s: float
    distance: float

    def state_at(self, elapsed_s: float) -> tuple[float, float]:
        """Return completed steps and steps/s, `elapsed_s` after the start."""
        if elapsed_s >= self.end_s:
            return self.distance, 0.0
        piece = self.pieces[0]
        for candidate in self.pieces:
            if candidate.begin_s > elapsed_s:
                break
            piece = candidate
        since_s = max(0.0, elapsed_s - piece.begin_s)
        rate = piece.rate + piece.slope * since_s
        return piece.steps + (piece.rate + rate) / 2 * since_s, rate

    def reached_s(self, steps: float) -> float:
        """Return the time at which `steps` are complete, at most `distance`."""
        if steps >= self.distance:
            return self.end_s
        piece = self.pieces[0]
        for candidate in self.pieces:
            if candidate.steps > steps:
                break
            piece = candidate
        steps_left = steps - piece.steps
        # 2 left / (rate + rate then) is the root that stays exact for small slopes.
        end_rate = math.sqrt(max(0.0, piece.rate**2 + 2 * piece.slope * steps_left))
        return piece.begin_s + 2 * steps_left / (piece.rate + end_rate)


def constant_profile(steps: float, rate: float) -> StepProfile:
    """`steps` at one rate: T below S (L2286-L2288), and homing at S (L2083-L2085)."""
    return StepProfile((_ProfilePiece(0.0, 0.0, rate, 0.0),), steps / rate, steps)


def trapezoid_profile(steps: float, start: float, top: float, ramp: float) -> StepProfile:
    """`steps` from rate `start` over `ramp` steps to `top` and back; `steps` may be infinite.

    A move shorter than two ramps keeps the slope and is a triangle (decision 13).
    """
    if top <= start:
        return constant_profile(steps, top)
    slope = (top**2 - start**2) / (2 * ramp)
    if steps < 2 * ramp:
        peak, ramp_steps = math.sqrt(start**2 + slope * steps), steps / 2
    else:
        peak, ramp_steps = top, ramp
    ramp_s = 2 * ramp_steps / (start + peak)
    cruise_s = (steps - 2 * ramp_steps) / peak
    pieces = (
        _ProfilePiece(0.0, 0.0, start, slope),
        _ProfilePiece(ramp_s, ramp_steps, peak, 0.0),
        _ProfilePiece(ramp_s + cruise_s, steps - ramp_steps, peak, -slope),
    )
    if math.isinf(steps):
        return StepProfile(pieces[:2], math.inf, math.inf)
    return StepProfile(pieces, 2 * ramp_s + cruise_s, steps)


def stop_profile(steps: float, rate: float, start: float, slope: float, max_steps: float) -> StepProfile | None:
    """Build the ramp from `steps` completed at `rate` down to `start`, ending on a whole step, at most `most`; None: no
    step is left."""
    if rate <= start or slope <= 0:
        return None
    distance = min(float(math.ceil(steps + (rate**2 - start**2) / (2 * slope) - 1e-6)), max_steps)
    distance_left = distance - steps
    if distance_left <= 1e-9:
        return None
    gentle = (rate**2 - start**2) / (2 * distance_left)
    return StepProfile((_ProfilePiece(0.0, steps, rate, -gentle),), 2 * distance_left / (rate + start), distance)
