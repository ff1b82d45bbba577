"""Parts of a mover whose moves are started by a command of the host: the timed write, and the result of a step."""

import asyncio
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from adapters.contract import HostInterval, MoveOutcome, TimedWrite, TimedWriter, WriteResult
from orchestrator.clock.base import NS_PER_MS, Clock
from orchestrator.clock.inferred import InferredClock
from orchestrator.model.errors import LATE_REMEDY, ControllerFault, Refusal
from orchestrator.model.state import StepCosts

ORDER_NS = 3 * NS_PER_MS  # from the order of a timed write to its instant, which is not missed then
WITHDRAW_NS = 10 * NS_PER_MS  # a request that comes this long before the start is still executed in time


def withdrawable_costs(costs: StepCosts, lead_ns: int, exchange_ns: int = 0) -> StepCosts:
    """Return the costs of a step that the host starts behind another one: until the starting command is written, it is
    withdrawn by not writing it.

    lead_ns: how long before T0 that is. exchange_ns: an exchange that may be under way."""
    return costs.model_copy(update={"disarm_ns": lead_ns + exchange_ns + WITHDRAW_NS})


def find_release_ns(lead_ns: int, wire_ns: int, *points: object) -> int | None:
    """Return how long before T0 a starting command must be ordered; None for a step with a trigger line.

    lead_ns: from its arrival to the motion. wire_ns: of its characters. points: an input that is waited for, or an
    output that is driven, if any."""
    is_line = any(point is not None for point in points)
    return None if is_line else lead_ns + wire_ns + ORDER_NS


@dataclass(frozen=True, slots=True)
class MoverTools:
    """What every mover of a host-started make needs. crystal: what is known about the controller's clock."""

    clock: Clock
    timed_writer: TimedWriter
    crystal: InferredClock


def cancelled_write_fault() -> ControllerFault:
    """Return the fault of a start whose timed write was cancelled."""
    return ControllerFault("not-started", "the timed write was cancelled", "")


async def wait_for_write(order: TimedWrite, is_cancelled: Callable[[], bool]) -> WriteResult:
    """Return the result of a timed write. Raises `ControllerFault` (`not-started`) for one that `is_cancelled`."""
    try:
        return await order.wait_until_written()
    except asyncio.CancelledError:
        if not is_cancelled():
            raise
        raise cancelled_write_fault() from None


def require_time_left(now_ns: int, at_ns: int) -> None:
    """Raise `Refusal` when the instant `at_ns` of the starting command has passed."""
    if now_ns >= at_ns:
        raise Refusal("late", "the instant to write the starting command has passed", LATE_REMEDY)


def moving_intervals(durations_s: Mapping[str, float], start: HostInterval, t0_ns: int) -> dict[str, HostInterval]:
    """Return the start of each axis: `start`, or T0 for an axis that stays where it is."""
    return {name: start if seconds else HostInterval(t0_ns, t0_ns) for name, seconds in durations_s.items()}


def resting_intervals(durations_s: Mapping[str, float], t0_ns: int) -> dict[str, HostInterval]:
    """Return the end of each axis that stays where it is: T0."""
    return {name: HostInterval(t0_ns, t0_ns) for name, seconds in durations_s.items() if not seconds}


def unmoved_outcome(durations_s: Mapping[str, float], t0_ns: int, failure: str, *, stopped: bool) -> MoveOutcome:
    """Return the outcome of a step in which the controller only drives a trigger line, if anything."""
    end_spans = {name: HostInterval(t0_ns, t0_ns) for name in durations_s}
    if failure:
        return MoveOutcome("fault", end_spans, failure)
    return MoveOutcome("stopped" if stopped else "done", end_spans, "stopped on request" if stopped else "")


def moved_outcome(
    ended: Mapping[str, HostInterval], reasons: Sequence[str], *, stopped: bool, failed: bool
) -> MoveOutcome:
    """Return the outcome of a move. stopped: a stop was requested. failed: the reasons are more than that stop."""
    if not reasons:
        return MoveOutcome("done", ended)
    if stopped and not failed:
        return MoveOutcome("stopped", ended, "; ".join(["stopped on request", *reasons]))
    return MoveOutcome("fault", ended, "; ".join(reasons))
