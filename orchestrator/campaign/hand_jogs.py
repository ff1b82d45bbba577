"""Jogs of a person during a phase of the campaign."""

import asyncio
from collections.abc import Callable, Mapping
from contextlib import suppress
from contextvars import Context
from dataclasses import replace
from random import Random

from orchestrator.campaign.jobs import SPEED_FRACTION, find_longest_move_s
from orchestrator.campaign.records import CampaignPhase, JogRecord
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock
from orchestrator.model.errors import Refusal
from orchestrator.runtime.virtual.fleet import VirtualFleet

RENEW_NS = 60 * NS_PER_MS
JOG_RENEWALS = 8  # of a jog, and of one that a fault shall interrupt
STAGE_RENEWALS = 32
_MAX_JOG_NS = 600 * NS_PER_MS  # from the begin of a jog to its fault, at most


class HandJogs:
    """Jogs axes of one fleet. find_positions: of each axis, in its unit. is_jogging: one that a fault shall interrupt
    is under way."""

    def __init__(
        self,
        virtual: VirtualFleet,
        clock: VirtualClock,
        draw: Random,
        find_positions: Callable[[], Mapping[str, float]],
    ) -> None:
        self.is_jogging = False
        self._virtual = virtual
        self._clock = clock
        self._draw = draw
        self._find_positions = find_positions

    async def jog_free_axis(self, phase: CampaignPhase) -> None:
        """Jog an axis that no job uses for a while."""
        busy = {name for order in phase.jobs.values() for name in order.controllers}
        free = [name for name in self._virtual.fleet.controllers if name not in busy] or [phase.member]
        await self.jog_axis(phase, self._draw.choice(free), JOG_RENEWALS)

    async def jog_axis(
        self, phase: CampaignPhase, name: str, renewals: int, reached: "asyncio.Future[tuple[str, int]] | None" = None
    ) -> None:
        """Jog an axis, and end without a stop command. reached: the future that triggers the fault."""
        axis_name, axis = next(iter(self._virtual.fleet.controllers[name].axes.items()))
        label = f"{name}.{axis_name}"
        reach = axis.limits.velocity * SPEED_FRACTION * find_longest_move_s(self._virtual.fleet)
        way = -1 if self._find_positions()[label] > reach / 2 else 1
        person = self._virtual.make_client("hand")
        with suppress(Refusal):
            async with person.manual_control([label]) as hand:
                begun_ns = self._clock.now_ns()
                phase.jogs.append(JogRecord(name, axis.motors[0], begun_ns, begun_ns))
                await hand.jog({label: way * axis.limits.velocity * SPEED_FRACTION / 2})
                if reached is not None:
                    self.is_jogging = True
                    at_ns = self._clock.now_ns() + self._draw.randrange(_MAX_JOG_NS)
                    self._clock.call_at_ns(at_ns, lambda: reached.set_result(("", 0)), context=Context())
                with suppress(Refusal):
                    for _ in range(renewals):
                        await sleep_ns(self._clock, RENEW_NS)
                        phase.jogs[-1] = replace(phase.jogs[-1], renewed_ns=self._clock.now_ns())
                        await hand.renew_jog()
                    await sleep_ns(self._clock, NS_PER_S)
                self.is_jogging = False
        await person.close()
