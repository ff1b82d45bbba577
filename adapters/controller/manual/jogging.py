"""Jogging of axes: a jog command is valid for a moment and renewed while the hold-to-run key is pressed; without
renewal the axis stops."""

import asyncio
import math
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from fractions import Fraction

from adapters.abilities import ManualDriver
from adapters.contract import ControllerReading, Driver, JogMove
from adapters.controller.state.background import BackgroundTasks
from adapters.controller.state.poll_timer import PollTimer
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_until_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.messages import JogRequest, JogRoom

HOLDERS_KEPT = 64
SPEED_TOLERANCE = 1e-9  # tolerance for a speed that was rounded in transit
# an axis that a poll finds at rest this long after its command has come to rest by itself
SEEN_MOVING_NS = 150 * NS_PER_MS


@dataclass(slots=True)
class _AxisJog:
    """One jogging axis.

    velocity: unit/s, of the last command that the controller has accepted.
    wanted: unit/s, of the last command that was sent.
    accepted_ns: when the controller accepted a command.
    end_words: what it has reached where it comes to rest by itself.
    begin: counts where it began, from which its reach counts."""

    holder: str
    until_ns: int
    velocity: float = 0.0
    wanted: float = 0.0
    accepted_ns: int | None = None
    end_words: str = "its soft limit"
    begin: int | None = None


class JogControl:
    """The jogs of one controller."""

    def __init__(
        self,
        driver: Driver,
        clock: Clock,
        status: ControllerStatus,
        tasks: BackgroundTasks,
        timer: PollTimer,
    ) -> None:
        self._driver = driver
        self._manual = driver if isinstance(driver, ManualDriver) else None
        self._clock = clock
        self._status = status
        self._tasks = tasks
        self._timer = timer
        self._command_lock = asyncio.Lock()
        self._jogs: dict[str, _AxisJog] = {}
        self._end_reasons: dict[str, str] = {}
        self._last_seq: dict[str, int] = {}
        self.find_reach: Callable[[str], float | None] = lambda axis: None
        """How far one jog of an axis goes, in its unit; None: to its soft limits."""
        self.find_room: Callable[[str], JogRoom | None] = lambda axis: None
        """Where zones allow it; None: everywhere."""

    # Requests of the lease holder

    def check_sequence(self, request: JogRequest) -> None:
        """Refuse a request that arrives after a later one: a late renewal must not follow a stop.

        Raises `Refusal`.
        """
        last = self._last_seq.pop(request.holder, 0)
        self._last_seq[request.holder] = max(last, request.seq)
        if len(self._last_seq) > HOLDERS_KEPT:
            del self._last_seq[next(iter(self._last_seq))]
        if request.seq <= last:
            raise Refusal("out-of-order", f"request {request.seq} came after request {last}", "")

    async def apply_request(self, request: JogRequest) -> None:
        """Begin, change, renew or stop jogs. Raises `Refusal`; then this call does not jog the axis that it names."""
        await self.stop_axes(
            [axis for axis, velocity in request.velocities.items() if velocity == 0], "the jog key is no longer pressed"
        )
        until_ns = self._clock.now_ns() + request.valid_ms * NS_PER_MS
        moving_velocities = {axis: velocity for axis, velocity in request.velocities.items() if velocity != 0}
        for axis in moving_velocities:
            if axis not in self._jogs and not request.renew:
                self._begin_jog(axis, _AxisJog(request.holder, until_ns))
        # All deadlines are set before the first command: a command may take longer than its own validity, and renewals
        # arrive meanwhile.
        jogs = {axis: self._jogs[axis] for axis in moving_velocities if axis in self._jogs}
        for jog in jogs.values():
            jog.until_ns = until_ns
        changed_jogs = {axis: jog for axis, jog in jogs.items() if jog.wanted != moving_velocities[axis]}
        for axis, jog in changed_jogs.items():
            jog.wanted = moving_velocities[axis]
        try:
            for axis in list(changed_jogs):
                await self._send_jog(axis, changed_jogs.pop(axis), moving_velocities[axis])
        except BaseException:
            for axis, jog in changed_jogs.items():
                self._revert_jog(axis, jog)
            raise
        for axis in moving_velocities:
            if axis not in jogs:
                reason = self._end_reasons.get(axis, "it is not jogging")
                raise Refusal("not-jogging", f"axis {axis}: {reason}", "press the jog key again")

    def _begin_jog(self, axis: str, jog: _AxisJog) -> None:
        self._jogs[axis] = jog
        self._status.jogging.add(axis)
        self._tasks.spawn(self._enforce_deadline(axis, jog))

    async def _send_jog(self, axis: str, jog: _AxisJog, velocity: float) -> None:
        async with self._command_lock:
            try:
                if self._jogs.get(axis) is jog:
                    await self._require_manual().jog_axis(axis, self._make_jog_move(axis, velocity, jog))
                    jog.velocity, jog.accepted_ns = velocity, self._clock.now_ns()
            except BaseException as error:
                self._revert_jog(axis, jog)
                if jog.velocity == 0 and not isinstance(error, Refusal):
                    # The controller may have accepted the command all the same. If the link is closed, the stop stays
                    # pending.
                    self._expect_rest([axis])
                    with suppress(ControllerFault, LinkClosed):
                        await self._require_manual().stop_axes([axis])
                raise
            if self._jogs.get(axis) is not jog:
                # The jog was stopped while the command was under way: the stop may have reached the controller first.
                await self._require_manual().stop_axes([axis])
        self._timer.wake_up()

    def _revert_jog(self, axis: str, jog: _AxisJog) -> None:
        """Revert to the last accepted velocity: the command was not sent or not accepted."""
        jog.wanted = jog.velocity
        if jog.velocity == 0:
            self._drop_jog(axis, jog, "the jog could not begin")

    def _make_jog_move(self, name: str, velocity: float, jog: _AxisJog) -> JogMove:
        """Return the move for the driver after all checks. Raises `Refusal`."""
        condition, axis = self._status, self._status.config.axes[name]
        reading = condition.require_online()
        condition.require_enabled([name])
        is_referenced = condition.referenced[name]
        fastest = axis.jog_speed(referenced=is_referenced)
        if abs(velocity) > fastest * (1 + SPEED_TOLERANCE):
            reference_text = "" if is_referenced else " while it is not referenced"
            raise Refusal(
                "too-fast",
                f"axis {name} may jog at {fastest:g} {axis.unit}/s at most{reference_text}, not at {abs(velocity):g}",
                "jog more slowly" if is_referenced else "jog more slowly, or home it first",
            )
        counts_s = velocity * float(axis.counts_per_unit)
        axis_reading = reading.axes[name]
        limit = "none" if axis_reading.limit_inferred else axis_reading.limit
        if limit in ("both", "forward" if counts_s > 0 else "reverse"):
            raise Refusal("limit", f"axis {name} is on its {limit} limit switch", "jog in the other direction")
        end = self._end_counts(name, axis, counts_s, reading)
        room = self.find_room(name) if is_referenced else None
        if room is not None:
            end, jog.end_words = _find_room_end(name, axis, axis_reading.commanded_counts, velocity, (end, room))
        reach = self.find_reach(name)
        if reach is not None:
            jog.begin = axis_reading.commanded_counts if jog.begin is None else jog.begin
            reach_counts = round(reach * abs(float(axis.counts_per_unit)))
            end = _find_nearer_end(name, axis_reading.commanded_counts, counts_s, (end, jog.begin, reach_counts))
        return JogMove(counts_s, axis.limits.acceleration * float(axis.scale), end)

    def _end_counts(self, name: str, axis: Axis, counts_s: float, reading: ControllerReading) -> int | None:
        limits = self._status.limits_counts([name])[name]
        if limits is None:
            return None
        end = limits[1] if counts_s > 0 else limits[0]
        if (end - reading.axes[name].commanded_counts) * counts_s <= 0:
            raise Refusal(
                "soft-limit",
                f"axis {name} is at its soft limit, {axis.to_unit(end):g} {axis.unit} (motor position)",
                "jog in the other direction",
            )
        return end

    def _require_manual(self) -> ManualDriver:
        if self._manual is None:
            raise Refusal("no-jog", "this make cannot jog an axis", "move it by a job")
        return self._manual

    # How jogs end

    async def _enforce_deadline(self, axis: str, jog: _AxisJog) -> None:
        while self._jogs.get(axis) is jog:
            until_ns = jog.until_ns
            await sleep_until_ns(self._clock, until_ns)
            if jog.until_ns == until_ns and self._jogs.get(axis) is jog:
                await self.stop_axes([axis], "the jog was not renewed in time")

    async def stop_axes(self, axes: Iterable[str], reason: str) -> None:
        """Stop those of `axes` that are jogging."""
        jogging = [axis for axis in axes if axis in self._jogs]
        if not jogging:
            return
        for axis in jogging:
            self._drop_jog(axis, self._jogs[axis], reason)
        self._expect_rest(jogging)
        await self._require_manual().stop_axes(jogging)
        self._timer.wake_up()

    def list_jogged(self, holder: str) -> list[str]:
        """The axes that `holder` jogs."""
        return [axis for axis, jog in self._jogs.items() if jog.holder == holder]

    def drop_all(self, reason: str) -> None:
        """Drop all jogs: the controller was stopped as a whole, or is lost."""
        for axis, jog in list(self._jogs.items()):
            self._drop_jog(axis, jog, reason)

    def handle_reading(self, reading: ControllerReading) -> None:
        """Handle a poll: an axis at rest has reached a limit; an axis that is off or faulted no longer jogs.

        The stop is sent all the same: on a disturbed line the reading may come from another controller's reply, or be
        wrong."""
        for axis, jog in list(self._jogs.items()):
            axis_reading = reading.axes[axis]
            if not axis_reading.enabled:
                self._tasks.spawn(self.stop_axes([axis], "its motor has switched off"))
            elif jog.wanted != jog.velocity:
                pass  # it may come to rest to change its speed
            elif (
                jog.accepted_ns is not None
                and not axis_reading.moving
                and reading.at_ns > jog.accepted_ns + SEEN_MOVING_NS
            ):
                reason = "it is on its limit switch" if axis_reading.limit != "none" else f"it is at {jog.end_words}"
                self._tasks.spawn(self.stop_axes([axis], reason))

    def _expect_rest(self, axes: Sequence[str]) -> None:
        """Expect `axes` to come to rest. A jog command may have been under way, and the stop may get lost: only a poll
        proves rest."""
        slowest_ns = math.ceil(max(self._deceleration_s(axis) for axis in axes) * 1e9)
        condition = self._status
        condition.stopped_ns = self._clock.now_ns()
        condition.stopping_until_ns = condition.stopped_ns + max(slowest_ns, self._driver.capabilities.costs.stop_ns)
        condition.stop_unseen = True

    def _deceleration_s(self, axis: str) -> float:
        config = self._status.config.axes[axis]
        return 0.1 + config.limits.velocity / config.limits.acceleration

    def _drop_jog(self, axis: str, jog: _AxisJog, reason: str) -> None:
        if self._jogs.get(axis) is jog:
            del self._jogs[axis]
            self._status.jogging.discard(axis)
            self._end_reasons[axis] = reason


def _find_room_end(
    name: str, axis: Axis, here: int, velocity: float, ends: tuple[int | None, JogRoom]
) -> tuple[int, str]:
    """Where a jog at a velocity (unit/s) ends, in counts, and what that is: its soft limit, or the end of its room.
    Raises `Refusal` there."""
    limit, room = ends
    position, rule = (room.high, room.high_by) if velocity > 0 else (room.low, room.low_by)
    end, sign = axis.to_counts(Fraction(position)), 1 if velocity * float(axis.counts_per_unit) > 0 else -1
    if (end - here) * sign <= 0:
        cause = f"zone {rule}" if rule else "its range"
        text = f"axis {name} may be jogged to {position:g} {axis.unit} (motor position) here, by {cause}"
        raise Refusal("zone", text, "jog in the other direction, or move the other axes of this zone away")
    if limit is not None and limit * sign <= end * sign:
        return limit, "its soft limit"
    return end, f"the end of its room among zones ({rule or 'its range'})"


def _find_nearer_end(name: str, here: int, counts_s: float, ends: tuple[int | None, int, int]) -> int:
    """Where a jog ends: at its soft limit, or its reach from where it began. ends: the soft limit, the beginning, the
    reach, in counts. Raises `Refusal` at the end of its reach."""
    limit, begin, reach = ends
    farthest = begin + reach if counts_s > 0 else begin - reach
    if (farthest - here) * counts_s <= 0:
        raise Refusal("jog-reach", f"axis {name} has gone as far as one jog of its pair goes", "jog again")
    if limit is None:
        return farthest
    return min(limit, farthest) if counts_s > 0 else max(limit, farthest)
