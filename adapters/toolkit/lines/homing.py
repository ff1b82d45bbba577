"""The search for the reference of a controller with text lines, which may not answer meanwhile."""

import asyncio
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

from adapters.toolkit.lines.dialect import LineStep
from adapters.toolkit.lines.unit import LineUnit
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal


class ReferenceSearch:
    """The searches of one connection."""

    def __init__(self, unit: LineUnit) -> None:
        self._unit = unit

    async def search(self, steps: Sequence[LineStep], since: int) -> str:
        """Run a search; return why it failed, or "". A search that is not waited for any more is stopped. since: number
        of stops at the time of the request."""
        unit = self._unit

        def check() -> None:
            unit.require_no_stop(since)
            unit.is_searching = True

        asking: asyncio.Task[None] | None = None
        if not self._unit.dialect.traits.answers_while_homing:
            asking = asyncio.get_running_loop().create_task(self._ask_during_search())
            steps = [self._accept_status(step) for step in steps]
        try:
            for number, step in enumerate(steps):
                if number == 0:
                    await unit.session.run_once(step, check)
                elif step.data:
                    await unit.session.run_step(step)
                if step.until:
                    await unit.session.wait_for_state(step)
        except (Refusal, ControllerFault) as error:
            if not unit.is_searching or (isinstance(error, ControllerFault) and unit.stops == since):
                raise
            return error.text
        except BaseException:
            if unit.is_searching:
                with suppress(LinkClosed):
                    unit.write_stop()
            raise
        finally:
            unit.is_searching = False
            if asking is not None:
                asking.cancel()
                unit.session.disturb()
        return "it was stopped" if unit.stops != since else ""

    def _accept_status(self, step: LineStep) -> LineStep:
        """Return a step of a search that also ends with a status at rest: the reply of its end may be lost."""
        is_done = step.is_done
        if is_done is None:
            return step

        def is_over(line: str) -> bool:
            status = self._unit.dialect.read_status([line])
            return is_done(line) or (status is not None and status.state != "moving")

        return replace(step, is_done=is_over)

    async def _ask_during_search(self) -> None:
        """Ask for the status now and then. A controller that searches does not answer; one that has ended does."""
        session, question = self._unit.session, self._unit.dialect.ask_status().data
        with suppress(LinkClosed):
            while True:
                await sleep_ns(self._unit.clock, NS_PER_S)
                session.write_at_once(question)
