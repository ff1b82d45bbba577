"""Probes by the host: this computer polls the input while an axis jogs to its end, and stops it."""

import asyncio
from contextlib import suppress

from adapters.abilities import ManualDriver
from adapters.contract import ControllerReading, HostInterval, JogMove, ProbedContact, ProbeMove
from adapters.controller.monitoring.polling import StatePolling
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.host_ability import READ_COUNTS, REST_COUNTS, WATCH_NS, find_host_ability
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.state import INPUT_S

PAUSE_NS = 5 * NS_PER_MS
POLL_S = (WATCH_NS - 2 * PAUSE_NS) / NS_PER_S
BEGIN_NS = 500 * NS_PER_MS  # in which a jog has begun that a poll shows at rest


class HostProbe:
    """Stops axes of one controller by its inputs."""

    def __init__(self, context: ControllerContext, status: ControllerStatus, polling: StatePolling) -> None:
        self._driver = context.driver if isinstance(context.driver, ManualDriver) else None
        self._costs = context.driver.capabilities.costs
        self._clock = context.clock
        self._status = status
        self._polling = polling
        self.ability = find_host_ability(context.driver, context.config)

    async def probe_axis(self, axis: str, move: ProbeMove) -> ProbedContact | None:
        """As `ProbeDriver.probe_axis`. Raises `Refusal`."""
        if self._driver is None:
            raise Refusal("no-probe", f"axis {axis}: this make cannot jog, and so cannot probe", "move it by a job")
        start = self._status.require_online()
        sign = 1 if move.end_counts >= start.axes[axis].commanded_counts else -1
        stopped_ns = self._status.stopped_ns
        try:
            await self._driver.jog_axis(axis, JogMove(sign * move.speed_counts_s, move.ramp_counts_s2, move.end_counts))
            return await self._watch(axis, move, sign, stopped_ns)
        except BaseException:
            with suppress(ControllerFault, LinkClosed):
                await self._driver.stop_axes([axis])
            raise

    async def _watch(self, axis: str, move: ProbeMove, sign: int, stopped_ns: int) -> ProbedContact | None:
        began_ns, passive = self._clock.now_ns(), self._status.require_online()
        while True:
            reading, read_ns = await self._read(axis), self._clock.now_ns()
            if self._status.stopped_ns != stopped_ns:
                raise Refusal("stopped", f"axis {axis} was stopped while it probed", "probe again")
            if reading.inputs.get(move.point.number, False) == move.level:
                await self._bring_to_rest(axis)
                return _find_contact(axis, move, sign, (passive, reading), read_ns)
            passive, axis_reading = reading, reading.axes[axis]
            is_at_end = abs(axis_reading.actual_counts - move.end_counts) <= REST_COUNTS
            if not axis_reading.moving and (is_at_end or self._clock.now_ns() - began_ns > BEGIN_NS):
                if is_at_end:
                    return None
                text = f"axis {axis} came to rest before its end, at {axis_reading.actual_counts:g} counts"
                raise Refusal("probe-broken", text, "see the state of the axis: a limit switch, a fault?")
            await sleep_ns(self._clock, PAUSE_NS)

    async def _read(self, axis: str) -> ControllerReading:
        """A new reading, within the time that the overtravel rests on. Raises `Refusal`."""
        try:
            async with asyncio.timeout(POLL_S):
                await self._polling.poll_and_publish()
        except TimeoutError:
            text = f"axis {axis}: a poll takes more than {POLL_S:g} s"
            raise Refusal(
                "probe-broken", text, "see what else uses its line or its computer, then probe again"
            ) from None
        return self._status.require_online()

    async def _bring_to_rest(self, axis: str) -> None:
        assert self._driver is not None
        await self._driver.stop_axes([axis])
        until_ns = self._clock.now_ns() + self._costs.stop_ns + NS_PER_S
        while self._clock.now_ns() < until_ns:
            await sleep_ns(self._clock, PAUSE_NS)
            await self._polling.poll_and_publish()
            if not self._status.require_online().axes[axis].moving:
                return
        raise ControllerFault("not-stopping", f"axis {axis} does not stop", "stop it at the controller", axis)


def _find_contact(
    axis: str, move: ProbeMove, sign: int, readings: tuple[ControllerReading, ControllerReading], read_ns: int
) -> ProbedContact:
    """The contact between two readings. An input may be sampled at another instant of a poll than a position, behind it
    too, and was changed before by its isolation. read_ns: when the second reading was complete."""
    passive, active = readings
    passive_window, active_window = (
        reading.sampled or HostInterval(reading.at_ns, reading.at_ns) for reading in readings
    )
    early_s = (passive_window.latest_ns - passive_window.earliest_ns) / NS_PER_S + INPUT_S
    late_s = (max(read_ns, active_window.latest_ns) - active_window.earliest_ns) / NS_PER_S
    ends = (
        passive.axes[axis].actual_counts - sign * (move.speed_counts_s * early_s + READ_COUNTS),
        active.axes[axis].actual_counts + sign * (move.speed_counts_s * late_s + READ_COUNTS),
    )
    first_ns = passive_window.earliest_ns - round(INPUT_S * NS_PER_S)
    return ProbedContact(min(ends), max(ends), HostInterval(first_ns, max(read_ns, active_window.latest_ns)))
