"""Detection of what nothing of this adapter has ordered: counts that jump, axes that move, settings that change.

A second master, or a person at the controller, may change anything. A move that rests on what was true before would go
somewhere else.
"""

from collections.abc import Mapping, Sequence

from adapters.abilities import find_differences
from adapters.contract import AxisReading, ControllerReading, SettingDifference
from adapters.controller.monitoring.step_positions import find_last_instant, find_misplaced_axes, find_wrong_ends
from adapters.controller.publishing.publisher import StatePublisher
from adapters.controller.state.armed_step import ArmedStep
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_S
from orchestrator.model.errors import NOT_REFERENCED, Refusal
from orchestrator.model.fleet import Axis

CHECK_PERIOD_NS = NS_PER_S
JUMP_COUNTS = 2  # a larger change of the commanded position is not rounding
RESTING_NS = NS_PER_S // 2  # an axis of the step before may settle for this long
DEADBAND_COUNTS = 10  # an axis at rest whose encoder moves by less does not move


class Surveillance:
    """Compares one controller with what this adapter has ordered."""

    def __init__(
        self, context: ControllerContext, status: ControllerStatus, steps: LoadedSteps, publisher: StatePublisher
    ) -> None:
        self._driver = context.driver
        self._clock = context.clock
        self._status = status
        self._steps = steps
        self._publisher = publisher
        self._ordered_axes = frozenset(status.config.axes)
        """Of the last reading: those that may have been moved by an order."""
        self._checked_ns = 0
        self._compared_ns = -NS_PER_S
        """When all settings were compared last, and were as expected."""
        self._outside: dict[str, AxisReading] = {}
        """Axes outside the step under way, as they were when it began to move."""
        self._resting_until_ns: dict[str, int] = {}

    def _has_other_motion(self) -> bool:
        """Whether anything that this adapter has ordered, except the step that it executes now, may change
        positions."""
        status, present = self._status, self._steps.present
        executes = present is not None and present.executes
        has_ended_step = not executes and (self._steps.is_followed or self._publisher.is_moving)
        return has_ended_step or bool(status.moved_singly) or status.stop_unseen

    def _find_ordered_axes(self, reading: ControllerReading) -> frozenset[str]:
        """The axes that may have been moved by an order of this adapter when they were read. A step that is only loaded
        moves nothing, and a released one nothing before its start."""
        if self._has_other_motion():
            return frozenset(self._status.config.axes)
        present = self._steps.present
        if present is None or not present.executes or present.is_before_begin(find_last_instant(reading)):
            return frozenset()
        return frozenset((*present.axes, *self._steps.ordered_axes))

    # Positions

    def find_jumps(self, before: ControllerReading | None, reading: ControllerReading) -> list[str]:
        """Drop the reference of axes whose count has changed at rest without an order; return these axes."""
        ordered_axes = self._find_ordered_axes(reading)
        at_rest_axes = self._status.config.axes.keys() - ordered_axes - self._ordered_axes
        self._ordered_axes = ordered_axes
        # A whole step may lie between two polls.
        ordered_ns = max(self._status.ordered_ns, self._steps.followed_ns)
        if before is None or ordered_ns >= before.at_ns:
            return []
        jumped_axes: list[str] = []
        for name in sorted(at_rest_axes):
            axis_reading, old, axis = reading.axes[name], before.axes[name], self._status.config.axes[name]
            by = axis_reading.commanded_counts - old.commanded_counts
            at_rest = not (axis_reading.moving or old.moving) and axis_reading.enabled and old.enabled
            if at_rest and abs(by) > JUMP_COUNTS and self._status.referenced[name]:
                jumped_axes.append(name)
                text = (
                    f"axis {name}: its position has changed by {axis.to_length(by):g} {axis.unit} at rest, without an "
                    "order: another client has set it, or moved it; it must be homed again"
                )
                self._drop_reference(name, text)
        return jumped_axes

    def find_outside_motion(self, moved: Sequence[str], reading: ControllerReading) -> str | None:
        """Return which axis moves although the step under way does not move it, in words. moved: the step's axes; none:
        no step is under way."""
        if not moved:
            self._outside = {}
            return None
        self._note_outside_axes(moved, reading)
        for name, began in self._outside.items():
            axis_reading, axis = reading.axes[name], self._status.config.axes[name]
            if not (axis_reading.enabled and began.enabled):
                continue
            was_commanded = abs(axis_reading.commanded_counts - began.commanded_counts) > JUMP_COUNTS
            if was_commanded or abs(axis_reading.actual_counts - began.actual_counts) > _deadband_counts(axis):
                by = axis.to_length(axis_reading.actual_counts - began.actual_counts)
                return f"axis {name} has moved by {by:g} {axis.unit}, although this step does not move it"
        return None

    def _note_outside_axes(self, moved: Sequence[str], reading: ControllerReading) -> None:
        """Note where the axes outside the step are. One that the step before has moved may come to rest first."""
        fresh = not self._outside
        for name, axis in reading.axes.items():
            if name in moved:
                self._outside.pop(name, None)
                continue
            if name not in self._outside and not fresh:
                self._resting_until_ns[name] = reading.at_ns + RESTING_NS
            if name not in self._outside or reading.at_ns < self._resting_until_ns.get(name, 0):
                self._outside[name] = axis

    def find_misplaced_axes(self, reading: ControllerReading) -> str | None:
        """Drop the reference of axes that are where the step that is released or moves brings them at no time; return
        that in words."""
        present = self._steps.present
        if present is None or not present.executes or reading.faults:
            return None
        misplaced_axes = find_misplaced_axes(self._status.config, present, self._steps.following.armed_step, reading)
        self.doubt_positions(misplaced_axes)
        return "; ".join(misplaced_axes.values()) or None

    def follow_play(self, reading: ControllerReading) -> None:
        """Follow the motors of drives with play to a reading. The step behind the present one may have begun when the
        end of this one is not seen yet."""
        present, following = self._steps.present, self._steps.following.armed_step
        has_begun = (
            following is not None and following.executes and not following.is_before_begin(find_last_instant(reading))
        )
        if present is not None and has_begun:
            self.note_end(present)
        self._status.play.handle_reading(reading, self._status.homing)

    def note_end(self, step: ArmedStep) -> None:
        """A step has ended as planned."""
        self._status.play.end_step(step)

    def find_wrong_ends(self, step: ArmedStep) -> dict[str, str]:
        """Axes that the last reading shows elsewhere than where the step, which is done, ends, in words."""
        reading = self._status.reading
        return {} if reading is None else find_wrong_ends(self._status.config, step, reading)

    def require_references(self, step: ArmedStep) -> None:
        """Raise `Refusal` for an axis of a loaded step that has lost its reference since."""
        for name in step.axes:
            if not self._status.referenced[name]:
                text = f"axis {name} has lost its reference since the step was loaded"
                raise Refusal(NOT_REFERENCED, text, f"home it first: a step `do: home` for {name}")

    def doubt_positions(self, wrong: Mapping[str, str]) -> None:
        """Drop the reference of axes whose motion was not as it was loaded. wrong: by axis, what was found."""
        for name, text in wrong.items():
            if self._status.referenced[name]:
                self._drop_reference(name, text)

    def _drop_reference(self, name: str, text: str) -> None:
        self._status.referenced[name] = False
        self._publisher.emit_event("unreferenced", text)

    # Settings

    async def check_next_settings(self) -> None:
        """Compare the next part of the settings, from time to time, while the controller is at rest."""
        now_ns = self._clock.now_ns()
        if self._has_other_motion() or self._steps.has_step or now_ns - self._checked_ns < CHECK_PERIOD_NS:
            return
        self._checked_ns = now_ns
        self.note_differences(await find_differences(self._driver, everything=False))

    def note_differences(self, found: Sequence[SettingDifference]) -> None:
        """Keep the controller from moving while a setting differs; report each once."""
        for difference in found:
            if difference.item in self._status.differences:
                continue
            self._status.differences[difference.item] = difference
            self._publisher.emit_event("setting", difference.to_fault().text)
            if difference.moves_reference:
                lost_axes = [name for name in self._status.config.axes if difference.axis in (None, name)]
                self._status.referenced.update(dict.fromkeys(lost_axes, False))
                self._publisher.emit_event(
                    "unreferenced", f"{', '.join(lost_axes)}: {difference.item} has changed; home again"
                )

    async def require_settings(self, valid_ns: int = 0) -> None:
        """Compare all settings, unless that was done within `valid_ns`. Raises `Refusal` when one that motion relies on
        is not as expected."""
        now_ns = self._clock.now_ns()
        if now_ns - self._compared_ns < valid_ns:
            return
        differences = await find_differences(self._driver, everything=True)
        if differences:
            self.note_differences(differences)
            raise differences[0].to_refusal()
        self._compared_ns = now_ns

    async def recheck_settings(self) -> None:
        """Compare all settings after a reset, and forget the differences that are gone."""
        self._status.differences.clear()
        self.note_differences(await find_differences(self._driver, everything=True))


def _deadband_counts(axis: Axis) -> float:
    window = 0.0 if axis.in_position_window is None else axis.in_position_window * abs(float(axis.scale))
    return max(DEADBAND_COUNTS, window)
