"""A controller's part in steps, over a driver that is scripted by the test."""

import asyncio
from collections.abc import Callable, Coroutine, Mapping
from types import SimpleNamespace
from typing import Any, Literal, cast

from adapters.contract import (
    Driver,
    DriverCapabilities,
    HostInterval,
    LoadPlace,
    Lowered,
    MoveOutcome,
    MoveSlot,
    MoveSlots,
    SettingDifference,
)
from adapters.controller.monitoring.settling import SettlingResult
from adapters.controller.slots.participant import StepParticipant
from adapters.controller.slots.parts import StepParts
from adapters.controller.slots.withdrawal import StepWithdrawal
from adapters.controller.state.armed_step import ArmedStep
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.loaded_steps import LoadedSteps
from orchestrator.clock.base import NS_PER_S, sleep_ns, sleep_until_ns
from orchestrator.clock.fleet import FleetScale
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.base import LinkClosed
from orchestrator.model.messages import ArmedReply, ArmRequest, CommitRequest, CommittedReply, GoRequest
from orchestrator.model.state import EventKind, StepCosts

T0_NS = 1 * NS_PER_S
NEXT_T0_NS = 2 * NS_PER_S
MOVE_S = 1.0  # duration of each move
MOVE_NS = round(MOVE_S * NS_PER_S)
FOLLOWING_T0_NS = T0_NS + MOVE_NS + NS_PER_S // 20  # of a step behind the first one
COSTS = StepCosts(arm_ns=1, disarm_ns=1, stop_ns=1)


class ScriptedSettling:
    """Axes that are at rest at once, and must be inside a window if the test says so."""

    def __init__(self, desk: "Desk") -> None:
        self._desk = desk

    def must_settle(self, _: object) -> bool:
        return self._desk.must_settle

    async def wait_until_settled(self, _: object) -> SettlingResult:
        self._desk.settled += 1
        return SettlingResult()


class ScriptedMover:
    """The mover of one slot of a driver. follows: its move is the following one."""

    def __init__(self, driver: "Scripted", *, follows: bool) -> None:
        self._driver = driver
        self._told = driver.told
        self.follows = follows

    async def load(self, lowered: Lowered, t0_ns: int, mapping: object, place: LoadPlace) -> dict[str, int]:
        if place == "at rest":
            self._told.append("arm")
            return {}
        assert self.follows == (place == "beside")
        self._told.append("load next" if self.follows else "arm behind")
        await self._driver.load()
        if self.follows:
            return {"wire": 5}
        self._driver.expect_another()
        return {"wire": 7}

    async def verify(self) -> None:
        self._told.append("verify next" if self.follows else "verify")

    async def release(self, start_tolerance_ns: int, advance_ns: int) -> None:
        driver, word = self._driver, "release next" if self.follows else "go"
        refused = driver.refuses_release if self.follows else driver.refuses_go
        self._told.append(f"{word} {advance_ns} ns sooner" if advance_ns else word)
        await driver.may_go.wait()
        if refused is not None:
            raise refused

    async def unload(self) -> None:
        """Like a real driver, which forgets the move first."""
        if self.follows:
            self._told.append("unload next")
            await self._driver.may_unload.wait()
            return
        if self._driver.closed:
            raise LinkClosed("the port is closed")
        self._told.append("disarm")

    async def wait_for_start(self) -> Mapping[str, HostInterval]:
        return await asyncio.shield(self._driver.begun)

    async def wait_for_end(self) -> MoveOutcome:
        self._told.append("outcome")
        return await asyncio.shield(self._driver.rested)


class Scripted:
    """A driver.

    told: the commands that it got, in their order.
    begun, rested: the results that `started` and `outcome` of the present move wait for.
    gap_ns: of all its moves: None for a controller that cannot hold a move beside the present one.
    may_...: while cleared, that command does not return. refuses_...: what it raises.
    compared: how often its settings were. differences: the settings that another client has changed."""

    def __init__(self) -> None:
        loop = asyncio.get_running_loop()
        self.told: list[str] = []
        self.begun: asyncio.Future[Mapping[str, HostInterval]] = loop.create_future()
        self.rested: asyncio.Future[MoveOutcome] = loop.create_future()
        self.refuses_go: Exception | None = None
        self.refuses_load: Exception | None = None
        self.refuses_release: Exception | None = None
        self.may_go, self.may_load, self.may_unload = asyncio.Event(), asyncio.Event(), asyncio.Event()
        for each in (self.may_go, self.may_load, self.may_unload):
            each.set()
        self.sooner = True
        self.closed = False
        self.gap_ns: int | None = None
        self.compared = 0
        self.checks_while_moving = False
        self.differences: list[SettingDifference] = []
        self.movers = ScriptedMover(self, follows=False), ScriptedMover(self, follows=True)
        self.slots = MoveSlots(MoveSlot(self.movers[0]), MoveSlot(self.movers[1]), self.take_over)

    async def load(self) -> None:
        await self.may_load.wait()
        if self.closed:
            raise LinkClosed("the port is closed")
        if self.refuses_load is not None:
            raise self.refuses_load

    def clock_mapping(self) -> None:
        return None

    @property
    def capabilities(self) -> DriverCapabilities:
        return DriverCapabilities(("clock",), (2,), False, COSTS, checks_while_moving=self.checks_while_moving)

    async def check_settings(self, *, everything: bool) -> list[SettingDifference]:
        assert everything
        self.compared += 1
        return self.differences

    def lower_profiles(self, *_: object) -> Lowered:
        return Lowered(
            "clock", {"x": MOVE_S}, {"x": 0.0}, (), 0, COSTS, (), can_advance=self.sooner, gap_ns=self.gap_ns
        )

    async def stop(self, abort: bool) -> None:
        if self.closed:
            raise LinkClosed("the port is closed")
        self.told.append("abort" if abort else "stop")

    def expect_another(self) -> None:
        loop = asyncio.get_running_loop()
        self.begun, self.rested = loop.create_future(), loop.create_future()

    def take_over(self) -> None:
        self.told.append("take next")
        for each in self.movers:
            each.follows = not each.follows
        self.expect_another()

    def begins(self, seen: bool = True, at_ns: int = T0_NS) -> None:
        self.begun.set_result({"x": HostInterval(at_ns, at_ns, seen)})

    def ends(self, state: Literal["done", "stopped", "fault"] = "done", at_ns: int = T0_NS + MOVE_NS) -> None:
        self.rested.set_result(MoveOutcome(state, {"x": HostInterval(at_ns, at_ns)}, "" if state == "done" else state))


class Desk:
    """A member of a step, and the driver below it.

    said: its events; events: with their steps.
    claimed: axes whose start they report.
    checks: the checks of profiles that were made. settled: how often it waited for rest. must_settle: as the axes of
    the fleet file state. defects: what ended a task unexpectedly."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.driver = Scripted()
        self.said: list[str] = []
        self.events: list[tuple[str, int]] = []
        self.checks: list[str] = []
        self.noted: list[SettingDifference] = []
        self.settled = 0
        self.must_settle = False
        self.valid_ns = 0
        self.defects: list[Exception] = []
        self.claimed: dict[str, set[str]] = {}
        self._tasks: list[asyncio.Task[None]] = []
        context = cast(
            ControllerContext,
            SimpleNamespace(
                controller="c",
                driver=self.driver,
                clock=clock,
                lowering_lock=asyncio.Lock(),
                require_scale=lambda: FleetScale("s", 0),
            ),
        )
        scripted: Any = self
        self.steps = LoadedSteps(cast(Driver, self.driver))
        self.withdrawal = StepWithdrawal(context, self.steps, cast(Any, ScriptedSettling(self)), scripted)
        parts: Any = StepParts(
            steps=self.steps,
            withdrawal=self.withdrawal,
            settling=cast(Any, ScriptedSettling(self)),
            surveillance=scripted,
            events=scripted,
            tasks=scripted,
        )
        self.member = StepParticipant(context, parts, scripted)

    # What the participant needs of its supervisor

    def check_step(self, _: object) -> None:
        self.checks.append("at rest")

    def check_following_step(self, _: object) -> None:
        self.checks.append("following")

    def doubt_positions(self, _: object) -> None:
        return

    def note_end(self, _: object) -> None:
        return

    def find_wrong_ends(self, _: object) -> dict[str, str]:
        return {}

    def require_references(self, _: object) -> None:
        return

    async def require_settings(self, valid_ns: int = 0) -> None:
        self.valid_ns = valid_ns
        differences = await self.driver.check_settings(everything=True)
        if differences:
            self.noted.extend(differences)
            raise differences[0].to_refusal()

    def spawn(self, coroutine: Coroutine[Any, Any, None]) -> None:
        self._tasks.append(asyncio.ensure_future(self._survive(coroutine)))

    def publish_state(self) -> None:
        return

    def emit_step(
        self, kind: EventKind, text: str, armed_step: ArmedStep, evidence: Mapping[str, object] | None = None
    ) -> None:
        self.said.append(kind)
        self.events.append((kind, armed_step.step))
        self.claimed[kind] = set(evidence or ())

    async def arm(self, step: int, t0_ns: int) -> None:
        await self.member.arm_step(ArmRequest(**self.ref(step), digest="d", t0_fleet_ns=t0_ns, profiles={}))

    async def go(self, step: int = 0, t0_ns: int = T0_NS, sooner_ns: int = 0) -> None:
        """Armed, promised and released, `sooner_ns` before the T0 that it was armed for."""
        await self.arm(step, t0_ns)
        await self.member.commit_step(CommitRequest(**self.ref(step), t0_fleet_ns=t0_ns))
        await self.member.start_step(GoRequest(**self.ref(step), t0_fleet_ns=t0_ns - sooner_ns, advance_ns=sooner_ns))

    async def move(self) -> None:
        """Step 0 moves, half of it is done."""
        await self.go()
        await self.wait_until(T0_NS + MOVE_NS // 2)
        self.driver.begins()
        await self.later(0.001)

    async def arm_next(self, t0_ns: int = FOLLOWING_T0_NS, step: int = 1, **changes: Any) -> ArmedReply:
        """Armed behind step 0, for `t0_ns`."""
        fields = self.ref(step) | {"digest": "d", "t0_fleet_ns": t0_ns, "profiles": {}, "after_step": 0} | changes
        return await self.member.arm_step(ArmRequest(**fields))

    async def promise_next(self, t0_ns: int = FOLLOWING_T0_NS) -> CommittedReply:
        return await self.member.commit_step(CommitRequest(**self.ref(1), t0_fleet_ns=t0_ns))

    async def release_next(self, sooner_ns: int = 0) -> None:
        t0_ns = FOLLOWING_T0_NS - sooner_ns
        await self.member.start_step(GoRequest(**self.ref(1), t0_fleet_ns=t0_ns, advance_ns=sooner_ns))

    async def end_present(self, state: Literal["done", "stopped", "fault"] = "done") -> None:
        """The moving step ends, at its instant."""
        await self.wait_until(T0_NS + MOVE_NS)
        self.driver.ends(state)
        await self.later(0.001)

    async def wait_until(self, at_ns: int) -> None:
        await sleep_until_ns(self.clock, at_ns)

    async def later(self, seconds: float = 0.01) -> None:
        await sleep_ns(self.clock, round(seconds * NS_PER_S))

    def ref(self, step: int) -> dict[str, Any]:
        """The fields that every request of a step has."""
        return {"request_id": "r", "actor": "a", "epoch": 1, "coordinator": "k", "job": "j", "step": step}

    async def _survive(self, coroutine: Coroutine[Any, Any, None]) -> None:
        try:
            await coroutine
        except LinkClosed:
            pass
        except Exception as error:  # an adapter reports that as a defect of its own
            self.defects.append(error)


def run(body: Callable[[Desk], Coroutine[Any, Any, None]]) -> None:
    async def main(clock: VirtualClock) -> None:
        await body(Desk(clock))

    run_virtual(main)
