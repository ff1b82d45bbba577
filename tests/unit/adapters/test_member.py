"""A controller's part in a step that goes wrong about its start, over a driver that is scripted by the test."""

import asyncio
from typing import Any, Literal

import pytest
from unit.adapters.scripted_member import NEXT_T0_NS, T0_NS, Desk, run

from adapters.contract import HostInterval, MoveOutcome
from adapters.controller.slots.withdrawal import STOP_LEAD_NS
from adapters.controller.state.armed_step import StepPhase
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import CommitRequest, DisarmRequest, GoRequest

SOONER_NS = NS_PER_S // 10
DEAF = ControllerFault("no-answer", "go was not answered", "")


def test_go_may_advance_the_promised_t0() -> None:
    async def body(desk: Desk) -> None:
        await desk.go(sooner_ns=SOONER_NS)
        assert desk.driver.told == ["arm", "verify", f"go {SOONER_NS} ns sooner"]
        ticket = desk.steps.present
        assert ticket is not None and ticket.phase is StepPhase.RELEASED
        assert ticket.t0_fleet_ns == ticket.t0_host_ns == T0_NS - SOONER_NS

    run(body)


@pytest.mark.parametrize(
    ("can", "sooner_ns", "code"), [(False, SOONER_NS, "not-sooner"), (True, -1, "not-sooner"), (True, T0_NS, "late")]
)
def test_a_member_that_cannot_start_sooner_reports_so_and_keeps_its_promise(
    can: bool, sooner_ns: int, code: str
) -> None:
    async def body(desk: Desk) -> None:
        desk.driver.sooner = can
        with pytest.raises(Refusal) as caught:
            await desk.go(sooner_ns=sooner_ns)
        assert caught.value.code == code and desk.driver.told == ["arm", "verify"]
        await desk.member.start_step(GoRequest(**desk.ref(0), t0_fleet_ns=T0_NS))
        assert desk.driver.told[2:] == ["go"]

    run(body)


@pytest.mark.parametrize(("before_ns", "begun"), [(2 * STOP_LEAD_NS, False), (STOP_LEAD_NS, True)])
def test_a_member_disarmed_during_go_is_stopped_at_once_and_reports_if_it_may_have_started(
    before_ns: int, begun: bool
) -> None:
    async def body(desk: Desk) -> None:
        desk.driver.may_go.clear()
        going = asyncio.ensure_future(desk.go())
        await sleep_ns(desk.clock, T0_NS - before_ns)
        unloading = asyncio.ensure_future(desk.withdrawal.disarm_step(DisarmRequest(**desk.ref(0))))
        await desk.later(0.001)
        assert desk.driver.told[2:] == ["go", "stop"] and not unloading.done()
        desk.driver.may_go.set()
        with pytest.raises(Refusal) as caught:
            await going
        assert caught.value.code == "stopped"
        assert (await unloading).may_have_started is begun
        assert desk.driver.told[-1] == "disarm" and desk.steps.present is None and desk.said == ["disarmed"]

    run(body)


def test_a_move_that_another_job_armed_is_not_disarmed() -> None:
    async def body(desk: Desk) -> None:
        await desk.go()
        told = list(desk.driver.told)
        others: tuple[dict[str, Any], ...] = ({"job": "k"}, {"step": 1})
        for other in others:
            assert (await desk.withdrawal.disarm_step(DisarmRequest(**(desk.ref(0) | other)))).may_have_started is False
        assert desk.driver.told == told and desk.steps.present is not None and not desk.said
        await desk.withdrawal.disarm_step(DisarmRequest(**desk.ref(0)))
        assert desk.steps.present is None and desk.driver.told[-1] == "disarm"

    run(body)


def test_a_step_that_is_stopped_as_it_starts_is_not_over_before_a_poll_shows_it_at_rest() -> None:
    async def body(desk: Desk) -> None:
        await desk.go()
        await desk.withdrawal.stop(abort=False, reason="stop")
        desk.driver.begins()
        await desk.later()
        assert desk.steps.is_followed
        desk.driver.rested.set_result(MoveOutcome("stopped", {}))
        await desk.later()
        assert not desk.steps.is_followed and desk.said == ["stopped"]

    run(body)


def test_the_end_of_a_step_that_was_stopped_at_its_start_is_not_taken_for_that_of_the_next() -> None:
    async def body(desk: Desk) -> None:
        await desk.go()
        await desk.withdrawal.stop(abort=False, reason="stop")
        await desk.arm(1, NEXT_T0_NS)
        desk.driver.begins()
        await desk.later()
        assert "outcome" not in desk.driver.told and not desk.steps.is_followed
        ticket = desk.steps.present
        assert ticket is not None and (ticket.step, ticket.phase) == (1, StepPhase.ARMED)

    run(body)


@pytest.mark.parametrize("closed", [True, False])
def test_a_member_that_received_go_is_stopped_or_has_a_pending_stop_when_its_link_breaks(closed: bool) -> None:
    """Its port may be open again by then, for other controllers on it."""

    async def body(desk: Desk) -> None:
        await desk.go()
        desk.driver.closed = closed
        desk.driver.begun.set_exception(LinkClosed("the port is closed"))
        await desk.later()
        assert desk.said == ["failed"]
        assert desk.steps.stop_pending is closed and ("stop" in desk.driver.told) is not closed
        desk.withdrawal.drop_step("the link is lost")
        assert not desk.steps.stop_pending

    run(body)


@pytest.mark.parametrize("stopped", [False, True])
def test_a_move_that_did_not_start_is_disarmed(stopped: bool) -> None:
    """Before the next step, which it would block; also when it was stopped meanwhile by another request."""

    async def body(desk: Desk) -> None:
        await desk.go()
        if stopped:
            await desk.withdrawal.stop(abort=False, reason="stop")
        desk.driver.begun.set_exception(ControllerFault("not-started", "axis x has not left its place", ""))
        await desk.later()
        assert desk.driver.told[-2:] == ["stop", "disarm"]
        assert desk.steps.present is None and desk.said == ["stopped" if stopped else "failed"]

    run(body)


@pytest.mark.parametrize("error", [DEAF, Refusal("late", "T0 is past")])
def test_a_member_that_refuses_go_is_stopped_before_it_is_disarmed(error: Exception) -> None:
    """It may have been released nevertheless, and only its answer was lost."""

    async def body(desk: Desk) -> None:
        desk.driver.refuses_go = error
        with pytest.raises(type(error)):
            await desk.go()
        assert desk.driver.told == ["arm", "verify", "go", "stop", "disarm"]
        assert desk.steps.present is None

    run(body)


@pytest.mark.parametrize("promised", [False, True])
def test_a_member_that_cannot_be_disarmed_has_a_pending_stop(promised: bool) -> None:
    """It may wait for a wired start, and it is unknown whether it has received the disarm request."""

    async def body(desk: Desk) -> None:
        await desk.arm(0, T0_NS)
        if promised:
            await desk.member.commit_step(CommitRequest(**desk.ref(0), t0_fleet_ns=T0_NS))
        desk.driver.closed = True
        with pytest.raises(LinkClosed):
            await desk.withdrawal.disarm_step(DisarmRequest(**desk.ref(0)))
        assert desk.steps.stop_pending
        desk.driver.closed = False
        await desk.withdrawal.disarm_step(DisarmRequest(**desk.ref(0)))
        assert not desk.steps.stop_pending and desk.driver.told[-1] == "disarm"

    run(body)


def test_a_move_that_did_not_start_is_not_disarmed_while_the_next_step_is_armed() -> None:
    async def body(desk: Desk) -> None:
        await desk.go()
        await desk.withdrawal.stop(abort=False, reason="stop")
        loaded: asyncio.Future[None] = asyncio.get_running_loop().create_future()

        async def arm(*_: object) -> dict[str, int]:
            await loaded
            desk.driver.told.append("arm")
            return {}

        desk.driver.movers[0].load = arm  # type: ignore[method-assign]
        arming = asyncio.ensure_future(desk.arm(1, NEXT_T0_NS))
        await desk.later()
        desk.driver.begun.set_exception(ControllerFault("not-started", "the program was halted", ""))
        await desk.later()
        loaded.set_result(None)
        await arming
        await desk.later()
        assert desk.driver.told == ["arm", "verify", "go", "stop", "arm"]

    run(body)


@pytest.mark.parametrize("seen", [True, False])
@pytest.mark.parametrize(("state", "kind"), [("done", "done"), ("fault", "failed")])
def test_an_unobserved_start_is_reported_only_after_the_move_is_done(
    state: Literal["done", "fault"], kind: str, seen: bool
) -> None:
    async def main(desk: Desk) -> None:
        await desk.go()
        desk.driver.begins(seen)
        await desk.later()
        desk.driver.rested.set_result(MoveOutcome(state, {"x": HostInterval(NEXT_T0_NS, NEXT_T0_NS)}))
        await desk.later()
        assert desk.claimed["started"] == ({"x"} if seen else set())
        assert desk.claimed[kind] == ({"x"} if seen or state == "done" else set())

    run(main)
