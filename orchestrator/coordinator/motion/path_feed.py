"""The course of a path while it is executed: chunk after chunk is planned, loaded by all members, and released.

A chunk that is not loaded in time is not released: the members brake along the path, by the tail of the present one. A
chunk that not all members have taken over, although all had loaded it, ends the step: the others would leave the path.
"""

import asyncio
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from typing import Any

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.motion.feed_pause import FeedPause
from orchestrator.coordinator.motion.negotiation import StartAgreement
from orchestrator.coordinator.motion.path_bound import ClockPromises, require_bound
from orchestrator.coordinator.motion.path_chunks import FirstChunk
from orchestrator.coordinator.motion.planning import StepRequest
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.coordinator.motion.start import StartState
from orchestrator.coordinator.switching.chunked import FeedTriggers
from orchestrator.model.errors import Refusal
from orchestrator.model.messages import (
    ChunkReply,
    LoadChunkRequest,
    ReleaseChunkRequest,
    Reply,
    raise_first_refusal,
)
from orchestrator.model.names import split_name
from orchestrator.model.profile import Profile
from orchestrator.plan.path_clock import PathClock
from orchestrator.plan.path_course import SWITCH_S, ChunkPlan
from orchestrator.plan.shape import PlanError
from orchestrator.plan.step import StepPlan

RELEASE_S = 0.4  # before the end of a chunk, releasing the next one begins at the latest
RETRY_S = 0.2
SHORT_CHUNK_S = 2.0  # after a change of speed, so that it can be loaded before
OVERRIDE_REACTIONS_S = (1.2, 2.4, 4.0)
REACTIONS_S = (0.3, 0.6, 1.2)  # from now to the place where a path is changed: loading and releasing fit in between

ChangeFrom = Callable[[float], Awaitable[None]]
"""Changes what is released of a path from an instant of its motion on. Raises `Refusal`, `PlanError`."""


class PathFeed:
    """The chunks of one path.

    chunk: the one that is released. failure: why the path is not continued beyond it. held_by: the originator of a feed
    hold, which brakes along the path.
    """

    def __init__(
        self, services: MotionServices, request: StepRequest, agreement: StartAgreement, state: StartState
    ) -> None:
        assert agreement.first is not None
        self._services = services
        self._request = request
        self._first: FirstChunk = agreement.first
        self._state = state
        self._bound = agreement.path.bound if agreement.path is not None else None
        self._proposals = agreement.proposals
        self._clocks = ClockPromises(self._bound, agreement.budget)
        self._lock = asyncio.Lock()
        self._changed = asyncio.Event()
        self._clock: PathClock = self._first.clock
        self.triggers = FeedTriggers(self._first.triggers, self._first.chunk)
        self.chunk: ChunkPlan = self._first.chunk
        self._numbers = 1
        self._revision = 0
        self._wanted = self._first.rate
        self.pause: FeedPause | None = None  # a later chunk is braked where it reaches that
        self._stated_s: Mapping[str, float] = {}
        self.ends_s: Mapping[str, float] = {}
        """By member, when it is at rest, as it states."""
        self.failure: Refusal | None = None
        self.held_by: str | None = None

    @property
    def is_complete(self) -> bool:
        """Whether what is released reaches the end of the path."""
        return self.chunk.last

    @property
    def plan(self) -> StepPlan:
        """The plan of the step up to the end of what is released."""
        profiles = {**self._first.plan.profiles, **self.chunk.profiles}
        return StepPlan(self.chunk.stop_s, profiles, self._first.plan.unmoved)

    @property
    def covers_all(self) -> bool:
        """Whether all members are on it, so that its speed can be changed."""
        return self._first.covers_all

    @property
    def lost(self) -> Refusal | None:
        """Why the path is not continued, where a member has all of it loaded, and would leave the others behind."""
        return None if self.covers_all else self.failure

    @property
    def rate(self) -> float:
        """The feed override, 1.0 as planned."""
        return self._wanted

    @property
    def times_s(self) -> tuple[float, float] | None:
        """How long it has moved, and how long it will, s; None while it is braked, or has not begun."""
        now_s, ends_s = self._now_s(), self._clock.find_instant(self._first.course.duration_s)
        if self.held_by is not None or not self._state.t0_fleet_ns or not now_s >= 0.0 or ends_s == float("inf"):
            return None
        return now_s, max(0.0, ends_s - now_s)

    def _now_s(self) -> float:
        return (self._services.leadership.fleet_now_ns() - self._state.t0_fleet_ns) / NS_PER_S

    # Continuation

    async def run(self) -> None:
        """Continue the path until it is held, or a chunk cannot be loaded. A task in parallel with the supervision of
        the step, which ends it: an override may take the last chunk back."""
        while self.failure is None and self.held_by is None:
            if self._lock.locked():
                # An override continues the path: loading beside it would take the place of its chunk.
                async with self._lock:
                    continue
            due_s = self.chunk.end_s - self._first.load_s
            self._changed.clear()
            with suppress(TimeoutError):
                async with asyncio.timeout(None if self.chunk.last else max(0.0, due_s - self._now_s())):
                    await self._changed.wait()
                continue
            await self._continue()

    async def _continue(self) -> None:
        """Load and release the next chunk, again as long as there is time."""
        revision, latest_s = self._revision, self.chunk.end_s - RELEASE_S
        begin_s, first = self.chunk.end_s - SWITCH_S, self._first
        # After a short chunk there is less time to load the next one.
        most_s = min(first.most_s, max(SHORT_CHUNK_S, first.most_s * (latest_s - self._now_s()) / first.load_s))
        try:
            clock = first.course.adapt_rate(self._clock, begin_s + SWITCH_S, self._wanted, most_s)
            if self.pause is not None:
                clock = self.pause.brake_in_chunk(first.course, clock, begin_s, most_s)
            following = first.course.plan_chunk(clock, begin_s, most_s)
        except (Refusal, PlanError) as error:
            self.failure = error if isinstance(error, Refusal) else Refusal("plan", str(error))
            return
        cause: Refusal | None = None
        while True:
            try:
                number = await self._load(following, latest_s)
                break
            except Refusal as refusal:
                if revision != self._revision:
                    return  # a hold or an override has taken its place
                self._services.fleet.log.warning(
                    f"chunk {following.begin_s:.1f} s: {refusal}", job=self._request.job_id
                )
                # The last attempt may have had no time for any member.
                cause = cause or refusal
                if self._now_s() + RETRY_S >= latest_s:
                    self.failure = cause
                    return
            await asyncio.sleep(RETRY_S)
        async with self._lock:
            if revision != self._revision:
                return
            try:
                await self._release(following, number)
            except Refusal as refusal:
                self.failure = refusal
            else:
                self._clock = clock
                if clock.rate <= 0.0 and self.pause is not None:
                    self.held_by = self.pause.actor

    async def _load(self, chunk: ChunkPlan, latest_s: float) -> int:
        """Have all members load a chunk, in the place of one that they are loading; return its number. Raises
        `Refusal`."""
        number, parts = self._numbers, self.triggers.find_parts(chunk)
        self._numbers += 1
        asked_requests = {
            member: LoadChunkRequest(
                **self._reference(number),
                begin_s=chunk.begin_s,
                chunk=self._first.make_options(member, chunk),
                profiles=profiles,
                triggers=parts.get(member, []),
            )
            for member, profiles in self._share(chunk.profiles).items()
        }
        replies = await self._services.fleet.requests.request_all(
            "load-chunk", asked_requests, ChunkReply, max(0.1, latest_s - self._now_s())
        )
        raise_first_refusal(replies)
        for member, reply in replies.items():
            self._clocks.require_within(member, reply, self._first.course.find_speed(member) * max(1.0, self._wanted))
        if self._now_s() > latest_s:
            raise Refusal("late", "the chunk was loaded too late", "")
        self._stated_s = {member: reply.stop_s for member, reply in replies.items()}
        self.triggers.note_promises(replies)
        return number

    async def _release(self, chunk: ChunkPlan, number: int) -> None:
        """Have all members change over to a loaded chunk. Raises `Refusal`: some of them may have."""
        requests = self._services.fleet.requests
        asked_requests = {
            member: ReleaseChunkRequest(**self._reference(number)) for member in self._share(chunk.profiles)
        }
        replies = await requests.request_all("release-chunk", asked_requests, Reply, RELEASE_S)
        refused_replies = [member for member, reply in replies.items() if reply.refused is not None]
        if (
            refused_replies
            and len(refused_replies) == len(replies)
            and all(_is_late(reply) for reply in replies.values())
        ):
            raise_first_refusal(replies)  # none has changed over
        self.chunk, self.ends_s = chunk, self._stated_s
        self.triggers.take_chunk(chunk)
        if refused_replies:
            await self._services.fleet.stop_members(
                list(asked_requests),
                "decelerate",
                self._request.job.actor,
                f"{refused_replies[0]} has not continued the path",
            )
            raise_first_refusal(replies)

    def _reference(self, number: int) -> dict[str, Any]:
        """The fields of every request about a chunk."""
        request = self._request
        fields = self._services.fleet.requests.request_fields(request.job.actor)
        t0_ns = self._state.t0_fleet_ns
        return {**fields, "job": request.job_id, "step": request.index, "t0_fleet_ns": t0_ns, "number": number}

    def _share(self, profiles: Mapping[str, Profile]) -> dict[str, dict[str, Profile]]:
        """The profiles by member and its own axis names; none for one that only switches outputs."""
        shares: dict[str, dict[str, Profile]] = {owner: {} for owner in self.triggers.owners}
        for axis, profile in profiles.items():
            member, name = split_name(axis)
            if member in self._first.members:
                shares.setdefault(member, {})[name] = profile
        return shares

    # Changes of speed

    async def hold(self, actor: str, path_s: float = 0.0) -> None:
        """Brake along the path as soon as all members can, at the latest at the end of what is released. path_s: but
        not before this place."""
        if self.held_by is not None or not self.covers_all:
            return
        self.held_by = actor
        least_s = self._clock.find_instant(path_s) if path_s else 0.0
        course = self._first.course
        await self._change(lambda at_s: self._cut(course.brake(self._clock, max(at_s, least_s))), REACTIONS_S, "held")

    async def _cut(self, clock: PathClock) -> None:
        """Brake by `clock` before the end of what is released, unless that ends before."""
        brake = clock.ramps[-1]
        if brake.begin_s >= self.chunk.end_s:
            return
        chunk = self._first.course.plan_stop(clock, brake.begin_s - SWITCH_S)
        await self._release(chunk, await self._load(chunk, brake.begin_s - SWITCH_S / 2))

    async def override(self, rate: float) -> None:
        """Play the path at another rate, from where all members can. Raises `Refusal`."""
        course = self._first.course
        self._first.require_rates()
        if self.held_by is not None or self.failure is not None:
            raise Refusal("override", "the path is being braked", "resume it first")
        if self._bound is not None:
            require_bound(self._bound, rate)
        self.triggers.require_rate(rate, self._proposals)
        course.require_rate(self._clock.find_path_s(self._now_s()), rate)
        self._wanted = rate
        await self._change(lambda from_s: self._change_rate(from_s, rate), OVERRIDE_REACTIONS_S, "changed")

    async def _change(self, change: ChangeFrom, reactions_s: Sequence[float], word: str) -> None:
        """Change what is released from the earliest place that all members can reach."""
        self._revision += 1
        async with self._lock:
            for reaction_s in reactions_s:
                try:
                    await change(self._now_s() + reaction_s)
                    break
                except (Refusal, PlanError) as error:
                    self._services.fleet.log.info(f"not {word} yet: {error}", job=self._request.job_id)
                if self.failure is not None:
                    break
            self._changed.set()

    async def _change_rate(self, from_s: float, rate: float) -> None:
        """Cut what is released short, and continue it from there at another rate. Where it ends before, the next chunk
        takes the rate on."""
        course = self._first.course
        cut = course.brake(self._clock, from_s)
        begin_s = cut.ramps[-1].begin_s
        if begin_s >= self.chunk.end_s:
            return
        changed_rate = course.adapt_rate(self._clock, begin_s, rate, SHORT_CHUNK_S)
        # Where it is braked if the next chunk does not come in time.
        await self._cut(cut)
        following = course.plan_chunk(changed_rate, self.chunk.end_s - SWITCH_S, SHORT_CHUNK_S)
        try:
            await self._release(following, await self._load(following, self.chunk.end_s - SWITCH_S / 2))
        except Refusal as refusal:
            self.failure = refusal
            raise
        self._clock = changed_rate


def _is_late(reply: Reply) -> bool:
    return reply.refused is not None and reply.refused.code == "late"
