"""Manual leases, against a coordinator and adapters that only record requests."""

import asyncio
from collections.abc import Callable, Coroutine
from typing import Any

import pytest

from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.memory.bus import MemoryNet
from orchestrator.client import Tutti
from orchestrator.client.manual import ManualControl
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.errors import Refusal
from orchestrator.model.jobs.service import AcquireAxes, AxesAcquired, ReleaseAxes
from orchestrator.model.messages import JogRequest, RefusalDetails, Reply
from orchestrator.model.operation.virtual_state import VirtualStates


class Stage:
    """A coordinator and two adapters. `refuse`: their answer to a verb from now on."""

    def __init__(self, clock: VirtualClock) -> None:
        self.clock = clock
        self.net = MemoryNet(clock, seed=3)
        self.keys = FleetKeys("lab")
        self.taken: list[AcquireAxes] = []
        self.returned: list[ReleaseAxes] = []
        self.jogs: list[tuple[str, JogRequest]] = []
        self.refuse: dict[str, str] = {}
        self.order_s = 0.0
        self.ordered: dict[str, dict[str, float]] = {}
        self._ids = 0

    async def start(self) -> Tutti:
        self.coordinator = self.net.join_process("coordinator")
        await self.coordinator.serve(self.keys.leader_answer("c"), self._lead)
        await self.coordinator.serve(self.keys.service("acquire-axes"), self._take)
        await self.coordinator.serve(self.keys.service("release-axes"), self._release)
        await self.coordinator.serve(self.keys.service("virtual"), self._list_virtual)
        for name in ("gantry", "stage"):
            await self.net.join_process(name).serve(self.keys.command(name, "jog"), self._jog(name))
        return Tutti(self.net.join_process("client"), "lab", "somebody", self._new_id)

    async def _lead(self, _: BusSample) -> bytes:
        return b"{}"

    async def _list_virtual(self, _: BusSample) -> bytes:
        return VirtualStates().to_json()

    def of(self, controller: str) -> list[JogRequest]:
        return [request for name, request in self.jogs if name == controller]

    def _new_id(self) -> str:
        self._ids += 1
        return f"{self._ids:08x}"

    def _refusal(self, verb: str) -> RefusalDetails | None:
        code = self.refuse.get(verb)
        return None if code is None else RefusalDetails(code=code, text=f"{verb}: {code}")

    async def _take(self, sample: BusSample) -> bytes:
        request = AcquireAxes.model_validate_json(sample.payload)
        self.taken.append(request)
        return AxesAcquired(refused=self._refusal("take"), axes=request.axes).to_json()

    async def _release(self, sample: BusSample) -> bytes:
        self.returned.append(ReleaseAxes.model_validate_json(sample.payload))
        return Reply().to_json()

    def _jog(self, name: str) -> Callable[[BusSample], Coroutine[Any, Any, bytes]]:
        async def answer(sample: BusSample) -> bytes:
            request = JogRequest.model_validate_json(sample.payload)
            self.jogs.append((name, request))
            before, self.ordered[name] = self.ordered.get(name), request.velocities
            if before != request.velocities and any(request.velocities.values()):
                await asyncio.sleep(self.order_s)
            return Reply(refused=self._refusal(name)).to_json()

        return answer


def on_stage(test: Callable[[Stage, Tutti], Coroutine[Any, Any, None]]) -> None:
    async def main(clock: VirtualClock) -> None:
        stage = Stage(clock)
        await test(stage, await stage.start())

    run_virtual(main)


def hand_of(tutti: Tutti) -> ManualControl:
    return tutti.manual_control(["gantry.x", "stage.u"], what="alignment")


def test_the_lease_is_acquired_renewed_and_released() -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        began_ns = stage.clock.now_ns()
        async with tutti.manual_control(["gantry.x"], what="alignment", ttl_s=3.0) as hand:
            assert hand.axes == ["gantry.x"]
            await asyncio.sleep(4.5)
        assert len(stage.taken) == 5
        assert {take.holder for take in stage.taken} == {hand.holder}
        assert stage.taken[0].what == "alignment"
        assert [back.holder for back in stage.returned] == [hand.holder]
        await asyncio.sleep(10)
        assert len(stage.taken) == 5
        assert stage.clock.now_ns() - began_ns > 14 * NS_PER_S

    on_stage(test)


def test_a_lease_is_released_although_the_user_code_fails() -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        with pytest.raises(ValueError, match="mistake"):
            async with hand_of(tutti) as hand:
                await hand.jog({"gantry.x": 5.0})
                raise ValueError("mistake")
        assert [request.velocities for request in stage.of("gantry")] == [{"x": 5.0}, {"x": 0.0}]
        assert len(stage.returned) == 1

    on_stage(test)


def test_a_slow_jog_command_is_renewed_meanwhile() -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        stage.order_s = 0.5
        async with hand_of(tutti) as hand:
            await hand.jog({"gantry.x": 5.0, "stage.u": 0.0})
        order, *renewals, stop = stage.of("gantry")
        assert not order.renew and len(renewals) == 8
        assert all(each.renew and each.velocities == {"x": 5.0} for each in renewals)
        assert [each.velocities for each in (order, stop)] == [{"x": 5.0}, {"x": 0.0}]
        assert [each.velocities for each in stage.of("stage")] == [{"u": 0.0}] * 2

    on_stage(test)


def test_a_slow_speed_change_is_renewed_meanwhile() -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        async with hand_of(tutti) as hand:
            await hand.jog({"gantry.x": 5.0})
            stage.order_s = 0.8
            await hand.renew_jog({"gantry.x": 2.0})
            told = [(each.renew, each.velocities["x"]) for each in stage.of("gantry")]
            assert told == [(False, 5.0), *[(True, 2.0)] * 14]

    on_stage(test)


@pytest.mark.parametrize("then", ["stopped", "cancelled", "another"])
def test_an_obsolete_jog_command_is_not_renewed(then: str) -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        stage.order_s = 0.5
        async with hand_of(tutti) as hand:
            ordering = asyncio.get_running_loop().create_task(hand.jog({"gantry.x": 5.0}))
            await asyncio.sleep(0.1)
            if then == "stopped":
                await hand.stop()
            elif then == "cancelled":
                ordering.cancel()
            else:
                await hand.jog({"gantry.x": -5.0})
            await asyncio.sleep(1.0)
            told = [(each.renew, each.velocities["x"]) for each in stage.of("gantry")]
            assert told[:2] == [(False, 5.0), (True, 5.0)]
            if then == "another":
                assert told[2:] == [(False, -5.0), *[(True, -5.0)] * 8]
            else:
                assert told[2:] == ([(False, 0.0)] if then == "stopped" else [])
            await asyncio.gather(ordering, return_exceptions=True)

    on_stage(test)


def test_each_acquisition_has_an_owner_of_its_own() -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        assert hand_of(tutti).holder != hand_of(tutti).holder

    on_stage(test)


def test_a_refused_client_holds_no_lease() -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        stage.refuse["take"] = "leased"
        with pytest.raises(Refusal) as error:
            async with hand_of(tutti):
                raise AssertionError
        assert error.value.code == "leased"
        assert stage.returned == []

    on_stage(test)


def test_jog_commands_go_to_each_controller_at_once_and_in_order() -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        async with hand_of(tutti) as hand:
            await hand.jog({"gantry.x": 5.0, "gantry.y": -1.0, "stage.u": 0.5})
            await hand.renew_jog()
            await hand.renew_jog({"gantry.x": 6.0})
            await hand.jog({"gantry.y": 0.0})
            await hand.renew_jog(valid_ms=100)
            await hand.stop()
            count = len(stage.jogs)
            await hand.stop()
            assert len(stage.jogs) == count
        gantry = stage.of("gantry")
        assert [(request.renew, request.velocities) for request in gantry] == [
            (False, {"x": 5.0, "y": -1.0}),
            (True, {"x": 5.0, "y": -1.0}),
            (True, {"x": 6.0, "y": -1.0}),
            (False, {"y": 0.0}),
            (True, {"x": 6.0}),
            (False, {"x": 0.0, "y": 0.0}),
        ]
        assert gantry[4].valid_ms == 100
        assert [request.velocities for request in stage.of("stage")] == [{"u": 0.5}] * 4 + [{"u": 0.0}]
        for name in ("gantry", "stage"):
            numbers = [request.seq for request in stage.of(name)]
            assert numbers == sorted(set(numbers))
        assert {request.holder for _, request in stage.jogs} == {hand.holder}

    on_stage(test)


def test_a_controller_that_refuses_stops_the_others() -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        async with hand_of(tutti) as hand:
            stage.refuse["stage"] = "not-enabled"
            with pytest.raises(Refusal) as error:
                await hand.jog({"gantry.x": 5.0, "stage.u": 1.0})
            assert error.value.code == "not-enabled"
            assert stage.of("gantry")[-1].velocities == {"x": 0.0}
            assert hand.lost is None
            # A program that goes on renewing learns that nothing moves.
            count = len(stage.jogs)
            with pytest.raises(Refusal, match="all axes were stopped"):
                await hand.renew_jog()
            assert len(stage.jogs) == count
            stage.refuse.clear()
            await hand.jog({"gantry.x": 5.0, "stage.u": 1.0})
            await hand.renew_jog()

    on_stage(test)


def test_a_lease_that_ended_early_is_reported_and_moves_nothing_more() -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        async with hand_of(tutti) as hand:
            stage.refuse["take"] = "permit"
            await asyncio.sleep(1.5)
            assert hand.lost is not None
            assert hand.lost.code == "permit"
            taken, sent = len(stage.taken), len(stage.jogs)
            with pytest.raises(Refusal, match="permit"):
                await hand.jog({"gantry.x": 5.0})
            await asyncio.sleep(5)
            assert (len(stage.taken), len(stage.jogs)) == (taken, sent)

    on_stage(test)


def test_a_lease_that_an_adapter_lacks_ends_in_the_client() -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        async with hand_of(tutti) as hand:
            await hand.jog({"gantry.x": 5.0})
            stage.refuse["gantry"] = "not-leased"
            with pytest.raises(Refusal):
                await hand.renew_jog()
            assert hand.lost is not None
            # A jog that has stopped already needs no stop: this is no refusal.
            await hand.stop()

    on_stage(test)


def test_a_coordinator_that_is_gone_ends_the_lease() -> None:
    async def test(stage: Stage, tutti: Tutti) -> None:
        async with hand_of(tutti) as hand:
            await stage.coordinator.close()
            await asyncio.sleep(1.5)
            assert hand.lost is not None
            assert hand.lost.code == "no-coordinator"

    on_stage(test)
