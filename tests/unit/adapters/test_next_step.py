"""A step behind the present one, in each of its phases, over a driver that is scripted by the test.

Two kinds of controllers: one that holds the step beside its present move, and one whose adapter loads it right behind
the end of that.
"""

import asyncio
from collections.abc import Awaitable, Callable
from typing import Any

import pytest
from unit.adapters.scripted_member import FOLLOWING_T0_NS, MOVE_NS, T0_NS, Desk, run

from adapters.contract import SettingDifference
from adapters.controller.slots.follower import READING_ROOM_NS
from adapters.controller.slots.withdrawal import STOP_LEAD_NS
from adapters.controller.state.armed_step import StepPhase
from adapters.controller.state.loaded_steps import QUIET_TURN_NS
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.messages import DisarmRequest

HELD_GAP_NS = 12 * NS_PER_MS
ENDED_NS = T0_NS + MOVE_NS
NO_ANSWER = ControllerFault("no-answer", "the release was not answered", "")
CHANGED = SettingDifference("IT of axis x", "0.5", "1")

Phase = str


async def reach(desk: Desk, phase: Phase) -> None:
    """Step 0 moves, and the step behind it is `armed`, `promised` or `released` in the controller, or held back by the
    adapter (`waiting`)."""
    desk.driver.gap_ns = None if phase == "waiting" else HELD_GAP_NS
    await desk.move()
    await desk.arm_next()
    if phase in ("promised", "released"):
        await desk.promise_next()
    if phase == "released":
        await desk.release_next()
    desk.driver.told.clear()


def behind(desk: Desk) -> StepPhase | None:
    """The phase of the step behind the present one; None if there is none."""
    following = desk.steps.following.armed_step
    return None if following is None else following.phase


def present(desk: Desk) -> tuple[int, StepPhase] | None:
    """Number and phase of the present step."""
    armed_step = desk.steps.present
    return None if armed_step is None else (armed_step.step, armed_step.phase)


async def disarm_next(desk: Desk) -> bool:
    """Disarm the following step; return whether it may have started."""
    return (await desk.withdrawal.disarm_step(DisarmRequest(**desk.ref(1)))).may_have_started


# As planned


def test_a_step_that_the_controller_holds_is_released_before_the_end_and_followed_from_then_on() -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns = HELD_GAP_NS
        await desk.move()
        reply = await desk.arm_next()
        assert not reply.waits and reply.stages_ns == {"wire": 5} and desk.checks == ["at rest", "following"]
        assert (await desk.promise_next()).armed is None
        await desk.release_next()
        assert present(desk) == (0, StepPhase.MOVING) and behind(desk) is StepPhase.RELEASED
        assert desk.driver.told[4:] == ["load next", "verify next", "release next"]
        await desk.end_present()
        assert present(desk) == (1, StepPhase.RELEASED) and behind(desk) is None
        assert desk.driver.told[7:] == ["take next"] and desk.steps.is_followed
        desk.driver.begins(at_ns=FOLLOWING_T0_NS)
        await desk.later(0.001)
        assert present(desk) == (1, StepPhase.MOVING)
        desk.driver.ends(at_ns=FOLLOWING_T0_NS + MOVE_NS)
        await desk.later(0.001)
        assert desk.events == [("started", 0), ("done", 0), ("started", 1), ("done", 1)]
        assert present(desk) is None and not desk.defects

    run(body)


def test_a_held_step_may_be_released_after_the_end_of_the_present_one() -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "promised")
        await desk.end_present()
        assert present(desk) == (1, StepPhase.COMMITTED) and desk.driver.told == ["take next"]
        await desk.release_next()
        assert present(desk) == (1, StepPhase.RELEASED) and desk.driver.told == ["take next", "go"]

    run(body)


def test_a_held_step_may_be_released_for_an_earlier_t0() -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "promised")
        await desk.release_next(sooner_ns=10 * NS_PER_MS)
        assert desk.driver.told == [f"release next {10 * NS_PER_MS} ns sooner"]
        await desk.end_present()
        armed_step = desk.steps.present
        assert armed_step is not None and armed_step.t0_host_ns == FOLLOWING_T0_NS - 10 * NS_PER_MS

    run(body)


def test_a_step_that_the_controller_cannot_hold_is_loaded_right_behind_the_end() -> None:
    async def body(desk: Desk) -> None:
        await desk.move()
        reply = await desk.arm_next()
        assert reply.waits and "load next" not in desk.driver.told and behind(desk) is StepPhase.ARMED
        promise = asyncio.ensure_future(desk.promise_next())
        await desk.wait_until(ENDED_NS - NS_PER_MS)
        assert not promise.done() and "arm behind" not in desk.driver.told
        desk.driver.may_load.clear()
        await desk.end_present()
        assert desk.driver.told[-1] == "arm behind" and present(desk) == (1, StepPhase.LOADING)
        assert not promise.done()  # it is not loaded yet
        desk.driver.may_load.set()
        armed = (await promise).armed
        assert armed is not None and armed.stages_ns == {"wire": 7}
        assert armed.took_ns == desk.clock.now_ns() - ENDED_NS  # counted from the promised end
        assert desk.driver.told[-2:] == ["arm behind", "verify"]
        await desk.release_next()
        assert present(desk) == (1, StepPhase.RELEASED)

    run(body)


def test_a_promise_that_is_asked_for_after_loading_has_what_was_loaded() -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "waiting")
        await desk.end_present()
        assert present(desk) == (1, StepPhase.ARMED)
        armed = (await desk.promise_next()).armed
        assert armed is not None and armed.stages_ns == {"wire": 7}
        assert present(desk) == (1, StepPhase.COMMITTED)

    run(body)


@pytest.mark.parametrize("checks_while_moving", [True, False])
def test_settings_are_compared_while_the_present_step_moves_where_the_make_can(checks_while_moving: bool) -> None:
    async def body(desk: Desk) -> None:
        desk.driver.checks_while_moving = checks_while_moving
        await desk.move()
        before = desk.driver.compared
        await desk.arm_next()
        assert desk.driver.compared - before == checks_while_moving
        await desk.end_present()
        assert desk.driver.compared - before == 1 and present(desk) == (1, StepPhase.ARMED)

    run(body)


@pytest.mark.parametrize("gap_ns", [HELD_GAP_NS, None])
def test_a_changed_setting_refuses_the_step_behind_and_leaves_the_present_one_alone(gap_ns: int | None) -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns, desk.driver.checks_while_moving = gap_ns, True
        await desk.move()
        desk.driver.differences = [CHANGED]
        with pytest.raises(Refusal) as caught:
            await desk.arm_next()
        assert caught.value.code == "setting-changed" and desk.noted == [CHANGED]
        assert "load next" not in desk.driver.told
        assert behind(desk) is None and present(desk) == (0, StepPhase.MOVING)

    run(body)


def test_a_member_that_must_settle_gets_the_step_only_after_it_is_at_rest() -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns, desk.must_settle = HELD_GAP_NS, True
        await desk.move()
        assert (await desk.arm_next()).waits and "load next" not in desk.driver.told
        await desk.end_present()
        assert desk.settled == 1 and desk.driver.told[-1] == "arm behind"

    run(body)


@pytest.mark.parametrize(("room_ns", "read"), [(READING_ROOM_NS + NS_PER_MS, 1), (READING_ROOM_NS - NS_PER_MS, 0)])
def test_the_controller_is_read_between_two_steps_only_behind_a_dwell(room_ns: int, read: int) -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns = HELD_GAP_NS
        await desk.move()
        await desk.arm_next(t0_ns=ENDED_NS + room_ns)
        await desk.end_present()
        assert desk.settled == read and present(desk) == (1, StepPhase.ARMED)
        # What the next plan begins at is read once the step is unloaded.
        await disarm_next(desk)
        assert desk.settled == 1

    run(body)


def test_the_controller_is_not_polled_near_the_turn_and_is_polled_before() -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "armed")
        await desk.wait_until(ENDED_NS - QUIET_TURN_NS - NS_PER_MS)
        assert desk.steps.quiet_until_ns(desk.clock.now_ns()) is None
        await desk.wait_until(ENDED_NS - QUIET_TURN_NS)
        assert desk.steps.quiet_until_ns(desk.clock.now_ns()) == ENDED_NS + QUIET_TURN_NS < FOLLOWING_T0_NS

    run(body)


def test_a_moving_controller_without_a_step_behind_is_polled_to_its_end() -> None:
    async def body(desk: Desk) -> None:
        await desk.move()
        await desk.wait_until(ENDED_NS - NS_PER_MS)
        assert desk.steps.quiet_until_ns(desk.clock.now_ns()) is None

    run(body)


def test_the_axes_of_a_step_behind_may_move_once_it_is_released() -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns = HELD_GAP_NS
        await desk.move()
        await desk.arm_next(profiles={})
        following = desk.steps.following._following
        assert following is not None
        object.__setattr__(following.armed_step, "axes", ("y",))
        assert desk.steps.ordered_axes == ()
        await desk.promise_next()
        await desk.release_next()
        assert desk.steps.ordered_axes == ("y",)

    run(body)


# What may not follow


@pytest.mark.parametrize("changes", [{"job": "other"}, {"after_step": 5}, {"after_step": None}])
def test_only_a_step_of_the_same_job_behind_the_present_one_may_follow(changes: dict[str, Any]) -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns = HELD_GAP_NS
        await desk.move()
        with pytest.raises(Refusal) as caught:
            await desk.arm_next(**changes)
        assert caught.value.code == "busy" and behind(desk) is None and "load next" not in desk.driver.told
        await desk.arm_next()
        assert behind(desk) is StepPhase.ARMED

    run(body)


def test_nothing_follows_a_step_that_is_not_released() -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns = HELD_GAP_NS
        await desk.arm(0, T0_NS)
        with pytest.raises(Refusal) as caught:
            await desk.arm_next()
        assert caught.value.code == "busy" and behind(desk) is None

    run(body)


@pytest.mark.parametrize("phase", ["waiting", "armed", "promised", "released"])
def test_there_is_room_for_one_following_step(phase: Phase) -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, phase)
        with pytest.raises(Refusal) as caught:
            await desk.arm_next(step=2, t0_ns=FOLLOWING_T0_NS + NS_PER_S)
        assert caught.value.code == "busy" and desk.driver.told == []
        following = desk.steps.following.armed_step
        assert following is not None and following.step == 1

    run(body)


def test_a_step_that_comes_too_late_for_its_t0_is_refused_and_the_present_one_continues() -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns = HELD_GAP_NS
        await desk.move()
        with pytest.raises(Refusal) as caught:
            await desk.arm_next(t0_ns=desk.clock.now_ns())
        assert caught.value.code == "late" and present(desk) == (0, StepPhase.MOVING)

    run(body)


@pytest.mark.parametrize("error", [Refusal("read-back", "XFT differs"), NO_ANSWER])
def test_what_could_not_be_loaded_is_unloaded_and_the_present_step_continues(error: Exception) -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns, desk.driver.refuses_load = HELD_GAP_NS, error
        await desk.move()
        with pytest.raises(type(error)):
            await desk.arm_next()
        assert desk.driver.told[-1] == "unload next" and behind(desk) is None
        await desk.end_present()
        assert desk.events[-1] == ("done", 0) and not desk.defects

    run(body)


def test_a_step_that_cannot_be_loaded_behind_the_end_is_not_promised() -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "waiting")
        promise = asyncio.ensure_future(desk.promise_next())
        desk.driver.refuses_load = Refusal("load-garbled", "understood something else")
        await desk.end_present()
        with pytest.raises(Refusal) as caught:
            await promise
        assert caught.value.code == "load-garbled" and present(desk) is None
        assert desk.driver.told[-1] == "disarm" and desk.events[-1] == ("done", 0) and not desk.defects

    run(body)


@pytest.mark.parametrize("promising", [True, False])
def test_a_link_that_is_lost_while_loading_behind_ends_the_promise(promising: bool) -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "waiting")
        desk.driver.may_load.clear()
        promise = asyncio.ensure_future(desk.promise_next()) if promising else None
        await desk.end_present()
        assert present(desk) == (1, StepPhase.LOADING)
        desk.driver.closed = True
        desk.driver.may_load.set()
        await desk.later(0.001)
        assert present(desk) is None and not desk.defects
        if promise is not None:
            with pytest.raises(LinkClosed):
                await promise

    run(body)


def test_a_lost_link_drops_both_steps() -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "released")
        desk.driver.closed = True
        desk.driver.rested.set_exception(LinkClosed("the port is closed"))
        await desk.later()
        assert present(desk) is None and behind(desk) is None
        assert desk.events[-2:] == [("failed", 0), ("failed", 1)] and desk.steps.stop_pending

    run(body)


# Ways out


async def by_stop(desk: Desk) -> None:
    await desk.withdrawal.stop("stop", abort=False)


async def by_abort(desk: Desk) -> None:
    await desk.withdrawal.stop("e-stop", abort=True)


async def by_failure(desk: Desk) -> None:
    await desk.withdrawal.fail_step("a limit switch")


async def by_new_leader(desk: Desk) -> None:
    await desk.withdrawal.abandon_step("the coordinator is lost")


async def by_drop(desk: Desk) -> None:
    desk.withdrawal.drop_step("the controller was restarted")


def test_a_promise_after_t0_is_late_and_not_unknown() -> None:
    """The step was unloaded at T0: its coordinator arms it again, with more lead time."""

    async def body(desk: Desk) -> None:
        await reach(desk, "armed")
        await desk.wait_until(FOLLOWING_T0_NS + NS_PER_S)
        with pytest.raises(Refusal) as caught:
            await desk.promise_next()
        assert caught.value.code == "late"

    run(body)


PHASES = ["waiting", "armed", "promised", "released"]


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize(
    ("way", "told", "kinds"),
    [
        (by_stop, ["stop"], ["stopped", "stopped"]),
        (by_abort, ["abort"], ["stopped", "stopped"]),
        (by_failure, ["stop"], ["failed", "stopped"]),
        (by_new_leader, ["stop"], ["stopped", "stopped"]),
        (by_drop, [], ["failed", "failed"]),
    ],
)
def test_whatever_ends_the_present_step_ends_what_follows_it(
    phase: Phase, way: Callable[[Desk], Awaitable[None]], told: list[str], kinds: list[str]
) -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, phase)
        await way(desk)
        assert desk.driver.told == told and present(desk) is None and behind(desk) is None
        assert desk.events[1:] == [(kinds[0], 0), (kinds[1], 1)]
        with pytest.raises(Refusal) as caught:
            await desk.promise_next()
        assert caught.value.code == "not-armed"
        desk.driver.ends("stopped")
        await desk.wait_until(FOLLOWING_T0_NS + NS_PER_S)
        assert len(desk.events) == 3 and "take next" not in desk.driver.told and "arm behind" not in desk.driver.told

    run(body)


@pytest.mark.parametrize("phase", PHASES)
def test_a_feed_hold_brakes_the_present_step_to_its_report_and_withdraws_what_follows(phase: Phase) -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, phase)
        await desk.withdrawal.stop("paused", abort=False, follow=True)
        assert desk.driver.told == ["stop"] and behind(desk) is None and present(desk) == (0, StepPhase.MOVING)
        desk.driver.ends("stopped", at_ns=desk.clock.now_ns())
        await desk.later()
        assert desk.events[1:] == [("stopped", 1), ("stopped", 0)] and present(desk) is None

    run(body)


@pytest.mark.parametrize("phase", PHASES)
@pytest.mark.parametrize("state", ["stopped", "fault"])
def test_nothing_follows_a_step_that_has_not_ended_as_planned(phase: Phase, state: Any) -> None:
    """One that is released waits in the controller: a stop unloads it for certain."""

    async def body(desk: Desk) -> None:
        await reach(desk, phase)
        await desk.end_present(state)
        unloading = {"waiting": [], "released": ["stop"]}.get(phase, ["unload next"])
        assert desk.driver.told == unloading and present(desk) is None and behind(desk) is None
        assert desk.events[1:] == [("disarmed", 1), ("stopped" if state == "stopped" else "failed", 0)]
        await desk.wait_until(FOLLOWING_T0_NS + NS_PER_S)
        assert "take next" not in desk.driver.told and "arm behind" not in desk.driver.told and not desk.defects

    run(body)


def test_a_step_that_took_another_time_than_promised_is_not_followed() -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "released")
        await desk.wait_until(ENDED_NS)
        desk.driver.ends("done", at_ns=ENDED_NS - NS_PER_S // 4)
        await desk.later(0.001)
        assert desk.driver.told == ["stop"] and desk.events[-2:] == [("disarmed", 1), ("failed", 0)]

    run(body)


@pytest.mark.parametrize("phase", ["waiting", "armed", "promised"])
def test_a_promise_that_waits_for_loading_ends_with_a_stop(phase: Phase) -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "waiting")
        promise = asyncio.ensure_future(desk.promise_next())
        await desk.later(0.001)
        await desk.withdrawal.stop("stop", abort=False)
        with pytest.raises(Refusal) as caught:
            await promise
        assert caught.value.code == "stopped"

    run(body)


@pytest.mark.parametrize("gap_ns", [HELD_GAP_NS, None])
def test_a_stop_while_the_step_is_being_loaded_unloads_it(gap_ns: int | None) -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns = gap_ns
        await desk.move()
        desk.driver.may_load.clear()
        if gap_ns is None:
            await desk.arm_next()
            loading = asyncio.ensure_future(desk.promise_next())
            await desk.end_present()
        else:
            loading = asyncio.ensure_future(desk.arm_next())  # type: ignore[assignment]
            await desk.later(0.001)
        await desk.withdrawal.stop("stop", abort=False)
        desk.driver.may_load.set()
        with pytest.raises(Refusal) as caught:
            await loading
        assert caught.value.code == "stopped" and present(desk) is None and behind(desk) is None
        assert desk.driver.told[-1] == ("disarm" if gap_ns is None else "unload next")

    run(body)


def test_a_step_that_is_loaded_as_the_present_one_ends_becomes_the_present_one() -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns = HELD_GAP_NS
        await desk.move()
        desk.driver.may_load.clear()
        loading = asyncio.ensure_future(desk.arm_next())
        await desk.end_present()
        assert present(desk) is None and not loading.done()
        desk.driver.may_load.set()
        await loading
        assert present(desk) == (1, StepPhase.ARMED) and desk.driver.told[-1] == "take next"

    run(body)


# The following step alone


@pytest.mark.parametrize("phase", PHASES)
def test_the_following_step_is_disarmed_and_the_present_one_continues(phase: Phase) -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, phase)
        assert await disarm_next(desk) is False
        assert desk.driver.told == ([] if phase == "waiting" else ["unload next"])
        assert behind(desk) is None and present(desk) == (0, StepPhase.MOVING)
        await desk.end_present()
        assert desk.events == [("started", 0), ("disarmed", 1), ("done", 0)] and present(desk) is None
        assert not desk.defects

    run(body)


@pytest.mark.parametrize(("before_ns", "told"), [(STOP_LEAD_NS + NS_PER_MS, "unload next"), (STOP_LEAD_NS, "stop")])
def test_a_released_step_is_stopped_when_it_is_disarmed_near_its_t0(before_ns: int, told: str) -> None:
    """The present move lasts to just before: it may still be noted as moving."""

    async def body(desk: Desk) -> None:
        await reach(desk, "released")
        await desk.wait_until(FOLLOWING_T0_NS - before_ns)
        assert await disarm_next(desk) is (told == "stop")
        assert desk.driver.told == [told] and behind(desk) is None

    run(body)


@pytest.mark.parametrize("phase", ["waiting", "armed", "promised"])
def test_a_step_without_go_is_unloaded_at_its_t0(phase: Phase) -> None:
    """Also behind a step that has not ended by then."""

    async def body(desk: Desk) -> None:
        await reach(desk, phase)
        await desk.wait_until(FOLLOWING_T0_NS - NS_PER_MS)
        assert behind(desk) is not None
        await desk.wait_until(FOLLOWING_T0_NS + NS_PER_MS)
        assert behind(desk) is None and present(desk) == (0, StepPhase.MOVING)
        assert desk.driver.told == ([] if phase == "waiting" else ["unload next"])
        assert desk.events[-1] == ("disarmed", 1)

    run(body)


@pytest.mark.parametrize("phase", ["waiting", "armed", "promised"])
def test_a_step_without_go_that_has_become_the_present_one_is_unloaded_at_its_t0(phase: Phase) -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, phase)
        await desk.end_present()
        assert present(desk) is not None
        await desk.wait_until(FOLLOWING_T0_NS + NS_PER_MS)
        assert present(desk) is None and desk.driver.told[-1] == "disarm"
        assert desk.events[-1] == ("disarmed", 1)

    run(body)


@pytest.mark.parametrize("error", [NO_ANSWER, Refusal("late", "it is too late to release the start")])
@pytest.mark.parametrize(("before_ns", "way"), [(STOP_LEAD_NS + NS_PER_MS, "unload next"), (STOP_LEAD_NS, "stop")])
def test_a_step_that_is_not_released_for_certain_is_unloaded_or_near_its_start_stopped(
    error: Exception, before_ns: int, way: str
) -> None:
    """It may have been released all the same."""

    async def body(desk: Desk) -> None:
        await reach(desk, "promised")
        desk.driver.refuses_release = error
        await desk.wait_until(FOLLOWING_T0_NS - before_ns)
        with pytest.raises(type(error)):
            await desk.release_next()
        assert desk.driver.told == ["release next", way] and behind(desk) is None
        assert present(desk) == (None if way == "stop" else (0, StepPhase.MOVING))

    run(body)


def test_a_step_whose_release_fails_after_the_end_of_the_present_one_is_unloaded() -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "promised")
        desk.driver.refuses_release = NO_ANSWER
        desk.driver.may_go.clear()
        going = asyncio.ensure_future(desk.release_next())
        await desk.end_present()
        assert present(desk) == (1, StepPhase.RELEASED)
        desk.driver.may_go.set()
        with pytest.raises(ControllerFault):
            await going
        assert present(desk) is None and desk.driver.told[-1] == "disarm" and desk.events[-1] == ("disarmed", 1)

    run(body)


def test_a_step_is_disarmed_past_a_release_that_is_under_way() -> None:
    """Its T0 is near."""

    async def body(desk: Desk) -> None:
        await reach(desk, "promised")
        desk.driver.may_go.clear()
        going = asyncio.ensure_future(desk.release_next())
        await desk.later(0.001)
        assert await disarm_next(desk) is False
        assert desk.driver.told == ["release next", "unload next"] and not going.done()
        desk.driver.may_go.set()
        with pytest.raises(Refusal) as caught:
            await going
        assert caught.value.code == "stopped" and behind(desk) is None

    run(body)


def test_a_stop_during_the_release_refuses_it() -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "promised")
        desk.driver.may_go.clear()
        going = asyncio.ensure_future(desk.release_next())
        await desk.later(0.001)
        await desk.withdrawal.stop("stop", abort=False)
        desk.driver.may_go.set()
        with pytest.raises(Refusal) as caught:
            await going
        assert caught.value.code == "stopped" and desk.driver.told == ["release next", "stop"]

    run(body)


@pytest.mark.parametrize("phase", ["armed", "promised", "released"])
def test_the_present_step_may_end_while_the_following_one_is_being_unloaded(phase: Phase) -> None:
    """The driver has forgotten the following step by then, and its controller does not begin it."""

    async def body(desk: Desk) -> None:
        await reach(desk, phase)
        desk.driver.may_unload.clear()
        unloading = asyncio.ensure_future(disarm_next(desk))
        await desk.end_present()
        desk.driver.may_unload.set()
        assert await unloading is False
        await desk.later()
        assert not desk.defects and present(desk) is None and behind(desk) is None
        assert desk.events[1:] == [("done", 0), ("disarmed", 1)]

    run(body)


def test_a_step_that_may_have_begun_while_it_was_being_unloaded_is_stopped() -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "released")
        desk.driver.may_unload.clear()
        await desk.wait_until(FOLLOWING_T0_NS - STOP_LEAD_NS - NS_PER_MS)
        unloading = asyncio.ensure_future(disarm_next(desk))
        await desk.wait_until(FOLLOWING_T0_NS + NS_PER_MS)
        desk.driver.may_unload.set()
        assert await unloading is True
        assert desk.driver.told == ["unload next", "stop"] and behind(desk) is None

    run(body)


def test_a_step_that_is_disarmed_while_it_is_being_loaded_does_not_stay() -> None:
    async def body(desk: Desk) -> None:
        desk.driver.gap_ns = HELD_GAP_NS
        await desk.move()
        desk.driver.may_load.clear()
        loading = asyncio.ensure_future(desk.arm_next())
        await desk.later(0.001)
        unloading = asyncio.ensure_future(disarm_next(desk))
        await desk.later(0.001)
        desk.driver.may_load.set()
        await asyncio.gather(loading, return_exceptions=True)
        assert await unloading is False
        assert behind(desk) is None and present(desk) == (0, StepPhase.MOVING)
        assert desk.driver.told[-1] == "unload next"

    run(body)


async def promise_anew(desk: Desk) -> None:
    """The step is armed from rest, for another T0, and promised at once."""
    t0_ns = FOLLOWING_T0_NS + NS_PER_S
    await desk.arm_next(t0_ns, after_step=None)
    async with asyncio.timeout(0.01):
        assert (await desk.promise_next(t0_ns)).armed is None
    assert present(desk) == (1, StepPhase.COMMITTED)


@pytest.mark.parametrize("loads", [True, False])
def test_what_was_loaded_behind_the_end_says_nothing_about_the_step_armed_anew(loads: bool) -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "waiting")
        desk.driver.refuses_load = None if loads else Refusal("load-garbled", "understood something else")
        await desk.end_present()
        await disarm_next(desk)
        assert present(desk) is None
        await promise_anew(desk)

    run(body)


def test_a_step_that_was_disarmed_before_its_loading_began_can_be_armed_and_promised_again() -> None:
    async def body(desk: Desk) -> None:
        await reach(desk, "waiting")
        async with desk.steps.transition_lock:  # another request is under way
            await desk.end_present()
            assert present(desk) == (1, StepPhase.LOADING)
            await desk.withdrawal.abandon_step("the coordinator is lost")
        await desk.later(0.001)
        await promise_anew(desk)

    run(body)
