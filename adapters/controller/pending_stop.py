"""The stop of a controller that cannot be reached: it is tried until it is sent, before anything else is sent."""

import asyncio
from collections.abc import AsyncGenerator, Awaitable
from contextlib import asynccontextmanager, suppress

from adapters.abilities import SharedLineDriver
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.link.last_stop import send_stop_once
from orchestrator.clock.base import NS_PER_MS, sleep_ns
from orchestrator.clock.owner import running
from orchestrator.link.base import LinkClosed

RETRY_NS = 200 * NS_PER_MS  # a pending stop is tried at least this often
LOOK_NS = 20 * NS_PER_MS  # between two looks whether a line has recovered


class PendingStop:
    """The pending stop of one controller."""

    def __init__(self, context: ControllerContext, steps: LoadedSteps) -> None:
        self._context = context
        self._steps = steps
        self._wake = asyncio.Event()
        self._attempt: asyncio.Timeout | None = None
        self._requested = 0
        self._sent = 0

    @property
    def is_pending(self) -> bool:
        """Whether a stop could not be sent yet."""
        return self._requested != self._sent

    def request_stop(self) -> None:
        """Have a stop sent as soon as the controller can be reached: a pause before the next attempt to connect ends
        now, and an attempt under way is given up, because the stop precedes everything else."""
        self._requested += 1
        self._wake.set()
        if self._attempt is not None and not self._attempt.expired():
            self._attempt.reschedule(asyncio.get_running_loop().time())

    async def pause_attempts(self, pause_ns: int) -> None:
        """Wait before the next attempt to connect: not longer than `RETRY_NS` while a stop is pending, and no longer
        once one is requested."""
        clock = self._context.clock
        self._wake.clear()
        alarm = clock.call_at_ns(
            clock.now_ns() + (min(pause_ns, RETRY_NS) if self.is_pending else pause_ns), self._wake.set
        )
        try:
            await self._wake.wait()
        finally:
            alarm.cancel()

    async def guard_attempt(self, attempt: Awaitable[None]) -> None:
        """Await an attempt to connect. Raises `LinkClosed` when a stop is requested meanwhile."""
        scope = self._attempt = asyncio.timeout(None)
        try:
            async with scope:
                await attempt
        except TimeoutError:
            if not scope.expired():
                raise
            raise LinkClosed("the attempt to connect was given up: a stop is sent first") from None
        finally:
            self._attempt = None

    @asynccontextmanager
    async def sent_first(self) -> AsyncGenerator[None]:
        """Send the pending stop, if any, before the block, which connects; and repeat it while the line is silent.

        The controller may be moving: the stop precedes every other command, as a guardian's does. It is pending because
        the link broke while a step was loaded, or before a stop could be sent.
        """
        if not self.is_pending:
            yield
            return
        await self._steps.wait_until_loaded()
        driver = self._context.driver
        if isinstance(driver, SharedLineDriver) and await driver.stop_before_connect():
            yield
            return
        context = self._context
        stop_answer = await send_stop_once(context.open_link, context.make.stop_bytes(context.config), context.clock)
        if stop_answer.answer:
            yield
            return
        async with running(self._repeat_until_answered(stop_answer.written_ns)):
            yield

    async def _repeat_until_answered(self, written_ns: int) -> None:
        """Write the stop again to the link that is being set up: while nothing is received, because bytes that are
        written to a broken line are lost, and setting up a connection waits for replies for seconds; and for the last
        time as soon as something is. written_ns: when it was written before."""
        context, clock = self._context, self._context.clock
        is_answered = False
        while not is_answered:
            await sleep_ns(clock, LOOK_NS)
            is_answered = context.trace.received_ns > written_ns
            link = context.current_link()
            if link is not None and (is_answered or clock.now_ns() - written_ns >= RETRY_NS):
                with suppress(LinkClosed):
                    link.write(context.make.stop_bytes(context.config))
                written_ns = clock.now_ns()

    async def send_stop(self) -> bool:
        """Send the pending stop to the connected controller: the one before was early, but the line may have recovered
        only after it. Return False if none is pending."""
        request_number = self._requested
        if not self.is_pending:
            return False
        await self._context.driver.stop(abort=False)
        self._sent = request_number
        return True
