"""A controller's part in a motion step: armed, committed, released, moving; and every way out of that.

The order is fixed (propose, arm, commit, go), each transition is checked against job, step and T0, and only a `go`
after a promise lets anything start. What interrupts (stop, e-stop, a lost coordinator) does not wait for it: it
raises `interruptions`, and whoever finds it raised after a wait unloads what it has loaded.
"""

import asyncio
from collections.abc import Awaitable, Callable, Coroutine, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import Any, Protocol

from adapters.contract import CannotDo, Driver, DriverFault, Span
from adapters.controller.clock import clock_mapping
from adapters.controller.settling import Settled
from orchestrator.clock.base import NS_PER_MS, Clock, sleep_until_ns
from orchestrator.clock.fleet import FleetScale
from orchestrator.link.base import LinkClosed
from orchestrator.model.messages import Arm, Armed, Commit, Disarm, Disarmed, Go, Proposal, Propose, Reply, StepRef
from orchestrator.model.state import AxisEvidence, EventKind, Interval

# Nothing polls a member this long before T0: its promise is a look, and the others are still being asked. Sixteen that
# are read just then have taken longer to go than they are given.
QUIET_NS = 300 * NS_PER_MS
# Nor so long after anything was asked of it for a step: arming looks at it, too, and the fleet waits for it.
ASKED_QUIET_NS = 250 * NS_PER_MS
STOPS_NS = 10 * NS_PER_MS  # so long before T0 a stop is written that is carried out before it


class Phase(Enum):
    """How far a ticket has come."""

    ARMED = "armed"
    COMMITTED = "committed"
    RELEASED = "released"
    MOVING = "moving"


@dataclass(frozen=True, slots=True)
class Ticket:
    """The step that the controller is loaded with."""

    job: str
    step: int
    t0_fleet_ns: int
    t0_host_ns: int
    axes: tuple[str, ...]
    scale: FleetScale
    sooner: bool
    phase: Phase = Phase.ARMED


class Emit(Protocol):
    """Puts an event about the step on the bus."""

    def __call__(
        self, kind: EventKind, text: str, ticket: Ticket, evidence: Mapping[str, AxisEvidence] | None = None
    ) -> None: ...


class Member:
    """One controller as a member of steps.

    check raises `CannotDo` when the profiles must not be executed now; settle waits for axes to come to rest at their
    targets, with a fresh state on the bus when it returns; lowering is shared by the members of a host (see `Seat`).
    """

    def __init__(
        self,
        controller: str,
        driver: Driver,
        clock: Clock,
        check: Callable[[Propose | Arm], None],
        scale: Callable[[], FleetScale],
        emit: Emit,
        settle: Callable[[Sequence[str]], Awaitable[Settled]],
        spawn: Callable[[Coroutine[Any, Any, None]], object],
        lowering: asyncio.Lock,
    ) -> None:
        self._controller = controller
        self._driver = driver
        self._clock = clock
        self._check = check
        self._scale = scale
        self._emit = emit
        self._settle = settle
        self._spawn = spawn
        self._lowering = lowering
        self._turn = asyncio.Lock()
        self._loading = asyncio.Lock()
        self._interruptions = 0
        self._followed = 0
        self._asked_ns = -ASKED_QUIET_NS
        self.ticket: Ticket | None = None
        self.stop_owed = False
        """What was released, and has failed, could not be stopped yet."""
        self.stop_ns = 0
        """What a stop of the last step takes at the most: its ramps may be gentler than any that the axes can do."""

    # The way of a step

    async def propose(self, request: Propose) -> Proposal:
        """Lower the profiles without touching the controller."""
        async with self._lowering:
            await asyncio.sleep(0)
            self._check(request)
            self._asked_ns = self._clock.now_ns()
            mapping = self._driver.mapping()
            lowered = self._driver.lower(request.profiles, request.start, mapping)
        at_ticks = mapping is not None and lowered.tick_ns > 0 and lowered.start_class == "clock"
        return Proposal(
            tick_at_fleet_ns=self._scale().fleet_ns(mapping.host_at_ns) if at_ticks and mapping is not None else None,
            durations_s=dict(lowered.durations_s),
            path_error_counts=dict(lowered.path_error_counts),
            costs=lowered.costs,
            start_class=lowered.start_class,
            tick_ns=lowered.tick_ns,
            terms=list(lowered.terms),
            edge=list(lowered.edge),
            clock_ppm=lowered.clock_ppm,
            sooner=lowered.sooner,
            commands=list(lowered.commands),
        )

    async def arm(self, request: Arm) -> Armed:
        """Load the move for T0, with the clock mapping of this moment frozen into it."""
        async with self._turn:
            if self.ticket is not None:
                raise CannotDo(
                    "busy", f"already {self.ticket.phase.value} for job {self.ticket.job}", "disarm it first"
                )
            began_ns, interruptions = self._clock.now_ns(), self._interruptions
            async with self._lowering:
                # A turn of the loop, for all that came while the last one was lowered.
                await asyncio.sleep(0)
                self._check(request)
                self._asked_ns = self._clock.now_ns()
                scale, mapping = self._scale(), self._driver.mapping()
                t0_ns = scale.host_ns(request.t0_fleet_ns)
                lead_ns = 0 if mapping is None else max(0, t0_ns - mapping.host_at_ns)
                how = request.start.model_copy(update={"lead_ns": lead_ns, "exact": True})
                lowered = self._driver.lower(request.profiles, how, mapping)
            if self._clock.now_ns() + lowered.costs.disarm_ns >= t0_ns:
                raise CannotDo("late", "T0 is too near to arm; the order to arm came late", "give more lead time")
            if interruptions != self._interruptions:
                raise CannotDo("stopped", "a stop came before arming", "")
            axes = tuple(request.profiles)
            ticket = Ticket(request.job, request.step, request.t0_fleet_ns, t0_ns, axes, scale, lowered.sooner)
            try:
                async with self._loading:
                    stages = await self._driver.arm(lowered, t0_ns, mapping)
            except (CannotDo, DriverFault):
                await self._driver.disarm()
                raise
            if interruptions != self._interruptions:
                await self._driver.disarm()
                raise CannotDo("stopped", "a stop came while arming", "")
            self.ticket, self.stop_ns = ticket, lowered.costs.stop_ns
            self._asked_ns = self._clock.now_ns()  # the promise is next
            self._spawn(self._expire(ticket))
            return Armed(
                durations_s=dict(lowered.durations_s),
                terms=list(lowered.terms),
                edge=list(lowered.edge),
                mapping=None if mapping is None else clock_mapping(self._controller, mapping, began_ns),
                took_ns=self._clock.now_ns() - began_ns,
                stages_ns=dict(stages),
            )

    async def commit(self, request: Commit) -> Reply:
        """Promise, after a last look at the controller."""
        async with self._turn:
            ticket = self._require(request, request.t0_fleet_ns, Phase.ARMED)
            interruptions = self._interruptions
            await self._driver.verify()
            if interruptions != self._interruptions or self.ticket is not ticket:
                raise CannotDo("stopped", "a stop came before the promise", "")
            self.ticket = replace(ticket, phase=Phase.COMMITTED)
            return Reply()

    async def go(self, request: Go) -> Reply:
        """Open the gate, for the T0 that was promised or a sooner one."""
        async with self._turn:
            sooner_ns = request.sooner_ns
            ticket = self._require(request, request.t0_fleet_ns + sooner_ns, Phase.COMMITTED)
            if sooner_ns and (sooner_ns < 0 or not ticket.sooner):
                raise CannotDo("not-sooner", "it begins at the T0 that it was armed for", "arm it for another one")
            t0_ns = ticket.t0_host_ns - sooner_ns
            if self._clock.now_ns() >= t0_ns:
                raise CannotDo("late", "T0 is past", "give more lead time")
            self.ticket = released = replace(
                ticket, phase=Phase.RELEASED, t0_fleet_ns=request.t0_fleet_ns, t0_host_ns=t0_ns
            )
            interruptions = self._interruptions
            try:
                await self._driver.go(request.slack_ns, sooner_ns)
            except (CannotDo, DriverFault):
                self.ticket = None
                # It may have been released all the same: what was only not answered must not run either.
                await self._driver.stop(False)
                await self._driver.disarm()
                raise
            if interruptions != self._interruptions or self.ticket is not released:
                await self._driver.disarm()
                raise CannotDo("stopped", "a stop came before the start", "")
            self._spawn(self._follow(released))
            return Reply()

    async def disarm(self, request: Disarm) -> Disarmed:
        """Unload the step, if it is the one that is loaded. A step that moves is not touched."""
        ticket, begun = self.ticket, False
        if ticket is not None and (ticket.job, ticket.step) != (request.job, request.step):
            return Disarmed()  # somebody else's, who still counts on it
        if ticket is not None and ticket.phase is Phase.RELEASED:
            # Past a `go` that is still under way, because T0 is near.
            self._interruptions += 1
            begun = self._clock.now_ns() + STOPS_NS >= ticket.t0_host_ns
            await self._driver.stop(False)
        async with self._turn:
            ticket = self.ticket
            if ticket is None:
                await self._unload()
                return Disarmed(begun=begun)
            if ticket.phase is Phase.MOVING:
                raise CannotDo("moving", "the step moves already", "stop it")
            self._interruptions += 1
            self.ticket = None
            if ticket.phase is Phase.RELEASED:
                # T0 may be this very moment: what can not be unloaded any more must not run either.
                await self._driver.stop(False)
            await self._unload()
            self._emit("disarmed", "disarmed on request", ticket)
            return Disarmed(begun=begun)

    # Ways out

    async def stop(self, abort: bool, reason: str, follow: bool = False) -> None:
        """Stop the controller now, whatever it does; nothing that is loaded starts afterwards. follow: the end of a
        step that moves is told once it is at rest, with its evidence."""
        self._interruptions += 1
        self._asked_ns = -ASKED_QUIET_NS
        if follow and self.ticket is not None and self.ticket.phase is Phase.MOVING:
            await self._driver.stop(abort)
            return
        ticket, self.ticket = self.ticket, None
        await self._driver.stop(abort)
        if ticket is not None:
            self._emit("stopped", reason, ticket)

    async def abandon(self, reason: str) -> None:
        """The coordinator is gone: unload what has not started, stop what moves."""
        ticket = self.ticket
        if ticket is None:
            return
        if ticket.phase in (Phase.RELEASED, Phase.MOVING):
            await self.stop(False, reason)
            return
        self._interruptions += 1
        self.ticket = None
        await self._unload()
        self._emit("disarmed", reason, ticket)

    async def _unload(self) -> None:
        """Unload whatever is loaded. If the link is given up meanwhile, nobody knows whether it was: a stop is owed."""
        self.stop_owed = True
        await self._driver.disarm()
        self.stop_owed = False

    async def fail(self, reason: str) -> None:
        """Something of the controller failed in motion: what still moves of it stops, and the coordinator hears why."""
        self._interruptions += 1
        ticket, self.ticket = self.ticket, None
        if ticket is not None:
            self._emit("failed", reason, ticket)
            await self._stop_failed()

    async def _stop_failed(self) -> None:
        """Stop what has failed. Raises `LinkClosed`, `DriverFault`: the stop is owed, then."""
        self.stop_owed = True
        await self._driver.stop(False)
        self.stop_owed = False

    def lost(self, reason: str) -> None:
        """The controller can not be reached any more, or has forgotten the step."""
        self._interruptions += 1
        self.stop_owed = False
        ticket, self.ticket = self.ticket, None
        if ticket is not None:
            self._emit("failed", reason, ticket)

    @property
    def loading(self) -> bool:
        """Whether a step is being loaded at this moment, though the link may have been given up meanwhile."""
        return self._loading.locked()

    async def loaded(self) -> None:
        """Until nothing is being loaded any more: on a line that others have open, that goes on without a link."""
        async with self._loading:
            pass

    def quiet_until_ns(self) -> int | None:
        """Until when nothing may be sent to the controller only to watch it; None: it may be."""
        ticket, now_ns = self.ticket, self._clock.now_ns()
        until_ns = self._asked_ns + ASKED_QUIET_NS
        if ticket is not None:
            if ticket.phase is Phase.MOVING:
                return None
            if ticket.t0_host_ns - QUIET_NS <= now_ns <= ticket.t0_host_ns:
                until_ns = ticket.t0_host_ns
        return until_ns if now_ns <= until_ns else None

    # Inside

    def _require(self, request: StepRef, t0_fleet_ns: int, phase: Phase) -> Ticket:
        ticket = self.ticket
        if ticket is None or (ticket.job, ticket.step, ticket.t0_fleet_ns) != (request.job, request.step, t0_fleet_ns):
            raise CannotDo("not-armed", f"not armed for job {request.job} step {request.step} at that T0", "arm it")
        if ticket.phase is not phase:
            raise CannotDo("wrong-phase", f"the step is {ticket.phase.value}, not {phase.value}", "")
        return ticket

    async def _expire(self, ticket: Ticket) -> None:
        """A step whose `go` has not come by T0 is unloaded."""
        await sleep_until_ns(self._clock, ticket.t0_host_ns)
        now = self.ticket
        same = now is not None and (now.job, now.step, now.t0_fleet_ns) == (ticket.job, ticket.step, ticket.t0_fleet_ns)
        if same and now is not None and now.phase in (Phase.ARMED, Phase.COMMITTED):
            await self.abandon("T0 came without a go")

    @property
    def following(self) -> bool:
        """Whether the driver has not come to the end of a step yet, though that may have been stopped."""
        return self._followed > 0

    async def _follow(self, ticket: Ticket) -> None:
        self._followed += 1
        try:
            await self._follow_to_end(ticket)
        finally:
            self._followed -= 1

    async def _follow_to_end(self, ticket: Ticket) -> None:
        """From the gate to the end of the move, with the controller's own evidence."""
        try:
            started = await self._driver.started()
            if self.ticket is not ticket:
                if self.ticket is None and not self._turn.locked():
                    await self._driver.outcome()  # stopped just then, and not over before somebody has seen it rest
                return
            moving = self.ticket = replace(ticket, phase=Phase.MOVING)
            evidence = {axis: _started(span, ticket.scale) for axis, span in started.items()}
            unseen = {axis for axis, span in started.items() if not span.seen}
            late_ns = max((span.late_ns for span in started.values()), default=0)
            text = f"started, {late_ns / 1e6:.1f} ms later than this host promises" if late_ns else "started"
            self._emit("started", text, moving, _without(evidence, unseen))
            outcome = await self._driver.outcome()
            # Who hears of the end plans the next step from the state: it must be that after the move.
            settled = await self._settle(ticket.axes if outcome.state == "done" else ())
            if self.ticket is not moving:
                return
        except (DriverFault, LinkClosed, CannotDo) as error:
            if self.ticket is not None and self.ticket.t0_fleet_ns == ticket.t0_fleet_ns:
                self.lost(str(error))
                if not isinstance(error, CannotDo):
                    await self._stop_failed()
            if isinstance(error, DriverFault):
                async with self._turn:  # not while the next step is armed
                    if self.ticket is None:
                        await self._driver.disarm()  # what did not start as it should is not to be in its way
            return
        self.ticket = None
        for axis, span in outcome.ended.items():
            if axis in evidence:
                ended = {"end": _interval(span, ticket.scale), "settled_s": settled.settled_s.get(axis)}
                evidence[axis] = evidence[axis].model_copy(update=ended)
        if outcome.state != "done":
            evidence = _without(evidence, unseen)
        kind = "failed" if settled.reason else _KIND_OF_END[outcome.state]
        self._emit(kind, settled.reason or outcome.reason or kind, moving, evidence)


_KIND_OF_END: dict[str, EventKind] = {"done": "done", "stopped": "stopped", "fault": "failed"}


def _without(evidence: Mapping[str, AxisEvidence], axes: set[str]) -> dict[str, AxisEvidence]:
    return {axis: each for axis, each in evidence.items() if axis not in axes}


def _started(span: Span, scale: FleetScale) -> AxisEvidence:
    return AxisEvidence(start=_interval(span, scale), late_ns=span.late_ns)


def _interval(span: Span, scale: FleetScale) -> Interval:
    """A span of host time in fleet time, widened by what the scale is not known."""
    return Interval(
        earliest_ns=scale.fleet_ns(span.earliest_ns) - scale.bound_ns,
        latest_ns=scale.fleet_ns(span.latest_ns) + scale.bound_ns,
    )
