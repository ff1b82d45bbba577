"""Another target for an axis on the way: from the place, speed and acceleration that it has at an instant."""

from dataclasses import dataclass

from orchestrator.model.profile import MotionState, Profile
from orchestrator.plan.shape import PlanError, solve_way
from orchestrator.plan.step import AxisMove

MAX_SEGMENTS = 500  # of a profile that was continued again and again


@dataclass(slots=True)
class _Segments:
    """The segments of a profile: lengths, s; accelerations at their beginnings, counts/s²; jerks, counts/s³."""

    durations_s: list[float]
    accelerations: list[float]
    jerks: list[float]

    def add(self, duration_s: float, acceleration: float, jerk: float) -> None:
        if duration_s > 0.0:
            self.durations_s.append(duration_s)
            self.accelerations.append(acceleration)
            self.jerks.append(jerk)

    def make_profile(self, profile: Profile, move: AxisMove) -> Profile:
        """The motion by these segments, from where `profile` begins to the target of `move`."""
        return Profile(
            start_counts=profile.start_counts,
            end_counts=move.target_counts,
            scale_counts=1.0,
            durations_s=self.durations_s,
            accelerations=self.accelerations,
            jerks=self.jerks,
        )


def continue_profile(profile: Profile, from_s: float, move: AxisMove) -> Profile:
    """The motion that is `profile` until `from_s`, and goes to the target of `move` from there, jerk-limited, in the
    shortest time. Raises `PlanError`: the axis has no jerk limit, or has got other targets too often."""
    if move.jerk is None:
        raise PlanError(f"{move.axis} has no jerk limit, and is not continued on the way")
    segments = _Segments([], [], [])
    for segment in profile.segments:
        length_s = min(segment.duration_s, from_s - segment.start_s)
        segments.add(length_s, segment.acceleration, segment.jerk)
    if len(segments.durations_s) > MAX_SEGMENTS:
        raise PlanError(f"{move.axis} has got other targets too often on one way")
    _add_way(segments, profile.state_at(from_s), move.target_counts - profile.start_counts, move)
    return segments.make_profile(profile, move)


def extend_profile(profile: Profile, from_s: float, move: AxisMove) -> Profile:
    """The trapezoid that is `profile` until `from_s`, and ends at the farther target of `move`: it keeps its speed for
    longer, and brakes later. Raises `PlanError`: its target is not farther, it brakes by then, or it is no
    trapezoid."""
    segments = [segment for segment in profile.segments if segment.duration_s > 0.0]
    brake = segments[-1]
    speed = profile.state_at(brake.start_s).velocity
    extra_counts = move.target_counts - profile.end_counts
    if move.jerk is not None or len(segments) < 2 or any(segment.jerk for segment in segments):
        raise PlanError(f"{move.axis} moves by no trapezoid, and is not sent farther on the way")
    if extra_counts * (profile.end_counts - profile.start_counts) <= 0:
        raise PlanError(f"the target of {move.axis} is not farther in its direction")
    if from_s >= brake.start_s:
        raise PlanError(f"{move.axis} brakes by then")
    course = _Segments([], [], [])
    for segment in segments[:-1]:
        course.add(segment.duration_s, segment.acceleration, 0.0)
    if course.accelerations[-1] == 0.0:
        course.durations_s[-1] += extra_counts / speed
    else:
        course.add(extra_counts / speed, 0.0, 0.0)
    course.add(brake.duration_s, brake.acceleration, 0.0)
    return course.make_profile(profile, move)


def _add_way(segments: _Segments, state: MotionState, target: float, move: AxisMove) -> None:
    """Add the way from `state` to rest at `target`, both relative to the start of the profile."""
    assert move.jerk is not None
    velocity = max(move.velocity, abs(state.velocity))
    parts = solve_way(state, target, (velocity, max(move.acceleration, abs(state.acceleration)), move.jerk))
    acceleration = state.acceleration
    for duration_s, jerk in parts:
        segments.add(duration_s, acceleration, jerk)
        acceleration += jerk * max(0.0, duration_s)
