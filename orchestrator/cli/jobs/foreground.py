"""Foreground commands: what such a command has begun ends with it.

The first interrupt (Ctrl-C, a closed terminal, SIGTERM) stops the job and reports; a second one leaves at once and says
what still moves. When the process itself is gone, its session ends, and the fleet stops the job.
"""

import asyncio
import contextlib
from collections.abc import Coroutine, Generator
from typing import TYPE_CHECKING, Any, TypeVar

from orchestrator.cli.base.codes import FAILED, INTERRUPTED
from orchestrator.cli.base.errors import errors
from orchestrator.clock.signals import TERMINAL_SIGNALS, calls_at_signals

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.jobs.job import Job
    from orchestrator.model.report import JobReport
    from orchestrator.model.state import ControllerState

T = TypeVar("T")

STOP_S = 3.0  # for the stop to be accepted, beyond which it counts as not sent


class Interrupts:
    """Counts interrupts of this process while its context lasts."""

    def __init__(self) -> None:
        self.count = 0
        self._changed = asyncio.Event()

    async def wait_for_next(self, seen: int = 0) -> None:
        """Wait until there have been more than `seen`."""
        while self.count <= seen:
            self._changed.clear()
            await self._changed.wait()

    def note_interrupt(self) -> None:
        self.count += 1
        self._changed.set()


@contextlib.contextmanager
def count_interrupts() -> Generator[Interrupts]:
    """Count interrupts instead of ending at the first."""
    interrupts = Interrupts()
    with calls_at_signals(interrupts.note_interrupt, TERMINAL_SIGNALS):
        yield interrupts


async def run_attended(tutti: "Tutti", job: "Job", *, wait: bool, quiet: bool) -> "JobReport":
    """Run a job that ends with this command, and return its report. wait: let it wait for other holders.

    Raises `Refusal` at once when it cannot begin and `wait` is not set; ends the process after an interrupt.
    """
    from orchestrator.cli.jobs.follow import follow_job
    from orchestrator.model.queue import QueueTerms

    async with tutti.attend() as attendance:
        terms = QueueTerms(session=attendance.session, now=not wait)
        with count_interrupts() as interrupts:
            # The answer is waited for in any case: a job whose id is unknown cannot be cancelled.
            entry = await tutti.enqueue_job(job, None, terms)
            report = await follow_unless_interrupted(follow_job(tutti, entry.id, quiet=quiet), interrupts)
            if report is not None:
                return report
            await stop_own_job(tutti, entry.id, controllers_of(job), interrupts)
    raise SystemExit(INTERRUPTED)


async def follow_unless_interrupted(following: Coroutine[Any, Any, T], interrupts: Interrupts) -> T | None:
    """The result of `following`; None after an interrupt."""
    follow = asyncio.ensure_future(following)
    interrupt = asyncio.ensure_future(interrupts.wait_for_next())
    try:
        await asyncio.wait([follow, interrupt], return_when=asyncio.FIRST_COMPLETED)
        return follow.result() if follow.done() else None
    finally:
        for task in (follow, interrupt):
            task.cancel()
        # The live screen is taken down before anything else is printed.
        await asyncio.gather(follow, interrupt, return_exceptions=True)


async def stop_own_job(tutti: "Tutti", job_id: str, controllers: list[str], interrupts: Interrupts) -> None:
    """Stop a job and report where its axes have come to rest. Ends the process at a further interrupt, and when no stop
    could be sent."""
    say("stopping …")
    count = interrupts.count
    stop = asyncio.ensure_future(_stop_and_wait(tutti, job_id, controllers))
    task_again = asyncio.ensure_future(interrupts.wait_for_next(count))
    await asyncio.wait([stop, task_again], return_when=asyncio.FIRST_COMPLETED)
    if not stop.done():
        stop.cancel()
        say(f"left before the stop was complete: {await _describe_motion(tutti, controllers)}")
        raise SystemExit(INTERRUPTED)
    task_again.cancel()
    if not stop.result():
        raise SystemExit(FAILED)


async def _stop_and_wait(tutti: "Tutti", job_id: str, controllers: list[str]) -> bool:
    """Stop the job and wait for its end. Return whether a stop was accepted."""
    from orchestrator.bus.base import BusError
    from orchestrator.model.errors import Refusal

    try:
        async with asyncio.timeout(STOP_S):
            await tutti.cancel_job(job_id)
    except (Refusal, BusError, TimeoutError) as error:
        if not (isinstance(error, Refusal) and error.code == "ended"):
            return await _stop_directly(tutti, controllers, str(error))
    report = await tutti.wait_for_job(job_id)
    position_text = await _describe_positions(tutti, controllers)
    say(f"stopped{position_text}" if report.state != "done" else f"done before the stop{position_text}")
    return True


async def _stop_directly(tutti: "Tutti", controllers: list[str], reason: str) -> bool:
    """Stop the controllers themselves, because the coordinator has not stopped the job. Return whether all have
    accepted it."""
    from orchestrator.bus.base import BusError
    from orchestrator.model.errors import Refusal
    from orchestrator.model.messages import Reply, StopRequest

    failures: list[str] = []
    present = list(await _find_states(tutti, []))
    # A group, or the whole fleet, is not resolved here: in doubt all controllers are stopped.
    controllers = controllers if controllers and set(controllers) <= set(present) else present
    for controller in controllers:
        request = StopRequest(**tutti.request_fields(), reason=f"stopped by {tutti.actor}")
        try:
            async with asyncio.timeout(STOP_S):
                await tutti.request_controller(controller, "stop", request, Reply)
        except (Refusal, BusError, TimeoutError) as error:
            failures.append(f"{controller}: {error or 'no answer'}")
    if failures or not controllers:
        say(f"NOT STOPPED ({reason}): {'; '.join(failures)}")
        say("use the e-stop: `tutti estop`, or the wired one")
        return False
    say(f"stopped: {', '.join(controllers)}; the coordinator has not confirmed the end of the job ({reason})")
    return True


async def _describe_positions(tutti: "Tutti", controllers: list[str]) -> str:
    """Where the axes of `controllers` are, in words, after a colon; empty if that is not known."""
    from orchestrator.cli.base.positions import describe_positions

    shown_positions = describe_positions(await _find_states(tutti, controllers))
    return f": {shown_positions}" if shown_positions else ""


async def _describe_motion(tutti: "Tutti", controllers: list[str]) -> str:
    """What still moves, in words."""
    states = await _find_states(tutti, controllers)
    if not states:
        return "whether anything moves is not known"
    moving_axes = [
        f"{name}.{axis}"
        for name, state in states.items()
        for axis, axis_now in state.axes.items()
        if axis_now.moving or axis_now.homing
    ]
    return f"{', '.join(moving_axes)} still moves" if moving_axes else "nothing moves"


async def _find_states(tutti: "Tutti", controllers: list[str]) -> "dict[str, ControllerState]":
    """The states of `controllers`, or of all if they are not the names of controllers; none if the bus is gone."""
    from orchestrator.bus.base import BusError

    try:
        states = await tutti.status(0.5)
    except BusError:
        return {}
    return {name: states[name] for name in controllers if name in states} or states


def say(text: str) -> None:
    """Print a line on standard error; a terminal that is gone does not prevent what comes after it."""
    with contextlib.suppress(OSError):
        errors.print(text, highlight=False, markup=False, soft_wrap=True)


def controllers_of(job: "Job") -> list[str]:
    """The controllers, or groups, that a job's steps name; none for the whole fleet."""
    from orchestrator.model.names import ALL_AXES
    from orchestrator.model.steps.tree import iterate_steps

    names: list[str] = []
    for step in iterate_steps(job.steps):
        if ALL_AXES in step.absolute_axes:
            return []  # those of a position, which the fleet knows
        names += step.switched_outputs or step.named_axes
    return list(dict.fromkeys(name.partition(".")[0] for name in names))
