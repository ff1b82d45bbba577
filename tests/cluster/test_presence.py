"""Nothing moves by surprise: commands that end with their process, breaks, and what a job waits for."""

import asyncio

import pytest
from cluster.worlds import MOVE, PREPARE, begin_ready, changed, demo_fleet, job, outcome, run_fleet

from adapters.yaskawa.smc4000.driver import SMC4000Driver
from orchestrator.client.api import Tutti
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Permit, QueuePolicy
from orchestrator.model.queue import SESSION_TIMEOUT_NS, QueueTerms, format_utc, parse_utc
from orchestrator.model.report import QueueEntry
from orchestrator.runtime.virtual.fleet import VirtualFleet

GANTRY = job("[{do: move, to: {gantry.x: 390}, speed: 0.1}]")
STAGE = job("[{do: move, to: {stage.u: 40}, speed: 0.1}]")
SHORT = job("[{do: move, by: {gantry.y: 1}}]")
RAMP_NS = 250 * NS_PER_MS
POLL_NS = 200 * NS_PER_MS


async def entry(client: Tutti, job_id: str) -> QueueEntry:
    shown = (await client.show_job(job_id)).entry
    assert shown is not None
    return shown


def motions(fleet: VirtualFleet) -> int:
    return sum(len(each.commanded_motions) for each in fleet.controllers.values())


async def attended_move(fleet: VirtualFleet) -> tuple[Tutti, str]:
    """A move of the gantry that belongs to a session whose process is killed while it moves."""
    client = fleet.make_client("ben")
    attendance = client.attend()
    await attendance.__aenter__()
    moving = await client.submit(GANTRY, terms=QueueTerms(session=attendance.session))
    await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
    await asyncio.sleep(3.0)
    assert fleet.controllers["gantry"].is_moving("X")
    await attendance.__aexit__()  # no further sign of life, and no other word
    return client, moving


# Commands that a person waits for


def test_a_move_ends_with_the_command_that_it_belongs_to() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client, moving = await attended_move(fleet)
        gone_ns = fleet.clock.now_ns()
        report = await client.wait_for_job(moving)
        assert report.state in ("cancelled", "aborted")
        motion = fleet.controllers["gantry"].commanded_motions[-1]
        assert motion.end_ns is not None
        assert motion.end_ns - gone_ns <= SESSION_TIMEOUT_NS + RAMP_NS + POLL_NS

    run_fleet(main)


def test_the_adapter_alone_stops_a_move_whose_command_is_gone() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("ben")
        async with client.attend() as attendance:
            await client.submit(GANTRY, terms=QueueTerms(session=attendance.session))
            await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
            await asyncio.sleep(3.0)
            coordinator = fleet.coordinators["first"][1]
            # The coordinator does not notice it.
            coordinator.scheduler._sessions.find_absent = lambda _: set()  # type: ignore[method-assign,assignment]
        gone_ns = fleet.clock.now_ns()
        await fleet.wait_until(lambda states: states["gantry"].mode == "idle")
        motion = fleet.controllers["gantry"].commanded_motions[-1]
        assert motion.end_ns is not None
        assert motion.end_ns - gone_ns <= SESSION_TIMEOUT_NS + RAMP_NS

    run_fleet(main)


def test_a_command_that_waits_and_is_gone_never_moves_anything() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        anna, ben = fleet.make_client("anna"), fleet.make_client("ben")
        _, holder = await anna.reserve_axes(["gantry"], 3600.0, "new belt")
        async with ben.attend() as attendance:
            waiting = await ben.submit(SHORT, terms=QueueTerms(session=attendance.session))
            await asyncio.sleep(5.0)
            assert (await entry(ben, waiting)).state == "queued"
        before = motions(fleet)
        await asyncio.sleep(2.0)
        await anna.release_axes(holder)
        await asyncio.sleep(10.0)
        assert (await entry(ben, waiting)).state == "cancelled"
        assert motions(fleet) == before

    run_fleet(main)


def test_a_command_that_must_not_wait_is_refused_with_holder_purpose_and_time() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        anna, ben = fleet.make_client("anna"), fleet.make_client("ben")
        await anna.reserve_axes(["gantry"], 3600.0, "new belt")
        with pytest.raises(Refusal, match=r"in use by anna \(new belt, until 20") as caught:
            await ben.submit(SHORT, terms=QueueTerms(now=True))
        assert caught.value.code == "leased"
        assert not (await ben.list_jobs(state="queued")).jobs

    run_fleet(main)


def test_a_command_of_a_person_comes_before_jobs_that_wait_and_in_spite_of_a_stopped_queue() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        await client.stop_queue()
        waiting = await client.submit(SHORT)
        async with client.attend() as attendance:
            own = await client.submit(SHORT, terms=QueueTerms(session=attendance.session, now=True))
            assert (await client.wait_for_job(own)).state == "done"
        assert (await entry(client, waiting)).state == "queued"
        with pytest.raises(Refusal, match="the queue is stopped") as caught:
            await client.submit(SHORT, terms=QueueTerms(now=True))
        assert caught.value.code == "queue-stopped"
        await client.start_queue()
        assert (await client.wait_for_job(waiting)).state == "done"

    run_fleet(main)


# Breaks


def restarted(fleet: VirtualFleet) -> None:
    fleet.kill("coordinator/first")
    fleet.kill("host/local")
    fleet.start_coordinator("second")


def power_cycled(fleet: VirtualFleet) -> None:
    fleet.act_on_controller("stage", lambda stage: stage.set_power(on=False))
    fleet.clock.call_at_ns(
        fleet.clock.now_ns() + 3_000 * NS_PER_MS,
        lambda: fleet.act_on_controller("stage", lambda stage: stage.set_power(on=True)),
    )


def host_killed(fleet: VirtualFleet) -> None:
    fleet.kill("host/local")


@pytest.mark.parametrize("happens", [restarted, power_cycled, host_killed])
@pytest.mark.parametrize("policy", ["stop", "continue"])
def test_after_a_break_no_waiting_job_begins_by_itself(happens: object, policy: str) -> None:
    queue = QueuePolicy.model_validate({"on_restart": policy})

    async def main(fleet: VirtualFleet) -> None:
        assert callable(happens)
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        _, holder = await client.reserve_axes(["gantry"], 3600.0)
        waiting = await client.submit(job("[{do: enable, axes: [gantry, stage]}, {do: home}]"))
        await asyncio.sleep(1.0)
        before = motions(fleet)
        happens(fleet)
        await asyncio.sleep(8.0)
        await fleet.wait_until(lambda states: all(each.mode == "idle" for each in states.values()))
        await client.release_axes(holder)
        if policy == "continue":
            assert (await client.wait_for_job(waiting)).state == "done"
            return
        await asyncio.sleep(30.0)
        assert motions(fleet) == before
        assert (await entry(client, waiting)).reason.startswith("the queue is stopped (")
        await client.start_queue()
        assert (await client.wait_for_job(waiting)).state == "done"

    run_fleet(main, demo_fleet().model_copy(update={"queue": queue}))


def test_a_break_without_waiting_jobs_stops_nothing() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        restarted(fleet)
        await asyncio.sleep(10.0)
        client = fleet.make_client("anna")
        assert (await client.list_jobs()).stopped is None
        assert (await client.wait_for_job(await client.submit(PREPARE))).state == "done"

    run_fleet(main)


@pytest.mark.parametrize("policy", ["hold", "continue"])
def test_a_failure_holds_the_jobs_that_need_its_controllers(policy: str) -> None:
    queue = QueuePolicy.model_validate({"on_failure": policy, "on_restart": "continue"})

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        failing = await client.submit(GANTRY)
        same, other = await client.submit(SHORT), await client.submit(job("[{do: move, by: {stage.u: 1}}]"))
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        await asyncio.sleep(1.0)
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_limit("X", "both"))
        assert (await client.wait_for_job(failing)).state == "failed"
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_limit("X", "none"))
        assert (await client.wait_for_job(other)).state == "done"
        if policy == "hold":
            await asyncio.sleep(30.0)
            assert (await entry(client, same)).held_by == f"job {failing}"
            await client.release_jobs(same)
        assert (await client.wait_for_job(same)).state == "done"

    run_fleet(main, demo_fleet().model_copy(update={"queue": queue}))


# What a job waits for


def test_a_job_waits_for_the_estop_to_be_reset_and_a_release_changes_nothing() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        await client.estop("a test")
        await asyncio.sleep(2.0)
        await client.start_queue()
        waiting = await client.submit(SHORT)
        await asyncio.sleep(5.0)
        assert (await entry(client, waiting)).reason == (
            "waits for: e-stop by anna: a test; make the machine safe, then `tutti reset`"
        )
        await client.release_jobs()
        await asyncio.sleep(5.0)
        assert (await entry(client, waiting)).state == "queued"
        await client.reset()
        await begin_ready(client, waiting)
        assert (await client.wait_for_job(waiting)).state == "done"

    run_fleet(main)


def test_jobs_wait_for_a_permit_until_it_has_settled() -> None:
    permit = Permit.model_validate({"input": "gantry.door", "value": False, "settle": "2 s"})

    async def main(fleet: VirtualFleet) -> None:
        await asyncio.sleep(3.0)
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=False))
        await fleet.wait_until(lambda states: states["gantry"].inputs["door"])
        waiting = [await client.submit(SHORT) for _ in range(3)]
        await asyncio.sleep(5.0)
        assert (await entry(client, waiting[0])).reason.startswith("waits for: permit door-closed does not hold")
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=True))
        await asyncio.sleep(1.0)
        assert (await entry(client, waiting[0])).reason.startswith("waits for: permit door-closed (")
        await begin_ready(client, *waiting)
        assert [(await client.wait_for_job(each)).state for each in waiting] == ["done"] * 3

    run_fleet(main, demo_fleet().model_copy(update={"permits": {"door-closed": permit}}))


@pytest.mark.parametrize(
    ("steps", "waits_for"),
    [
        ("[{do: move, by: {gantry.x: 1}}]", "waits for: gantry.x is not enabled; enable: `tutti axis enable gantry.x`"),
        (
            "[{do: enable, axes: [gantry]}, {do: move, by: {gantry.x: 1, gantry.y: 1}}]",
            "waits for: gantry.x, gantry.y are not referenced; home: `tutti axis home gantry.x gantry.y`",
        ),
    ],
)
def test_a_job_waits_for_references_and_motors_that_none_of_its_steps_provides(steps: str, waits_for: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        waiting = await client.submit(job(steps))
        await asyncio.sleep(5.0)
        assert (await entry(client, waiting)).reason == waits_for
        async with client.attend() as attendance:
            own = await client.submit(PREPARE, terms=QueueTerms(session=attendance.session))
            await client.wait_for_job(own)
        await begin_ready(client, waiting)
        assert (await client.wait_for_job(waiting)).state == "done"

    run_fleet(main)


def test_a_job_waits_for_a_controller_that_is_off_and_another_job_does_not() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        fleet.wires["stage"].cut = True
        await fleet.wait_until(lambda states: states["stage"].mode == "offline")
        waiting = await client.submit(job("[{do: enable, axes: [stage]}, {do: home, axes: [stage]}]"))
        assert (await client.wait_for_job(await client.submit(SHORT))).state == "done"
        assert (await entry(client, waiting)).reason.startswith("waits for: stage is offline")
        fleet.wires["stage"].cut = False
        await begin_ready(client, waiting)
        assert (await client.wait_for_job(waiting)).state == "done"

    run_fleet(main)


def test_a_job_that_expires_is_cancelled_with_what_it_waited_for() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        end = format_utc(
            parse_utc(fleet.clock.utc()).fromtimestamp(parse_utc(fleet.clock.utc()).timestamp() + 60).astimezone()
        )
        waiting = await client.submit(job("[{do: move, by: {gantry.x: 1}}]"), terms=QueueTerms(expires=end))
        report = await client.wait_for_job(waiting)
        assert report.state == "cancelled"
        assert report.reason.startswith("expired at ")
        assert "gantry.x is not enabled" in report.reason
        with pytest.raises(Refusal, match="in the past") as caught:
            await client.submit(SHORT, terms=QueueTerms(expires=end))
        assert caught.value.code == "past"

    run_fleet(main)


# What stands in the way, and what nothing has ordered


def test_a_member_on_its_limit_switch_is_refused_by_name_before_any_member_moves() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE, job("[{do: move, to: {gantry.x: 10, stage.u: 2}}]"))
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_limit("X", "forward"))
        await fleet.wait_until(lambda states: states["gantry"].axes["x"].limit == "forward")
        before = motions(fleet)
        report = await outcome(fleet, MOVE)
        assert report.state == "failed"
        refused = report.steps[-1].refused
        assert refused is not None
        assert (refused.code, refused.member) == ("limit-switch", "gantry")
        assert "axis x is on its forward limit switch" in refused.text
        assert motions(fleet) == before
        away = await outcome(fleet, job("[{do: move, to: {gantry.x: 5, stage.u: 3}}]"))
        assert away.state == "done"

    run_fleet(main)


def test_a_count_that_jumps_at_rest_unreferences_the_axis_and_nothing_moves_by_it() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE, job("[{do: move, to: {gantry.x: 100}}]"))
        client = fleet.make_client("anna")
        await client.send_raw("gantry", "DPX=50000", i_know=True)
        states = await fleet.wait_until(lambda states: not states["gantry"].axes["x"].referenced)
        assert states["gantry"].axes["y"].referenced
        before = motions(fleet)
        with pytest.raises(Refusal, match=r"gantry\.x is not referenced"):
            await client.submit(job("[{do: move, to: {gantry.x: 120}}]"), terms=QueueTerms(now=True))
        await asyncio.sleep(5.0)
        assert motions(fleet) == before

    run_fleet(main)


def test_an_idle_axis_that_moves_during_a_step_stops_the_step(monkeypatch: pytest.MonkeyPatch) -> None:
    """Gearing of a second master that no check of settings has found: the positions alone show it."""

    async def find_nothing(*_: object, **__: object) -> tuple[()]:
        return ()

    monkeypatch.setattr(SMC4000Driver, "check_settings", find_nothing)

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        await client.send_raw("gantry", "GAY=X;GRY=0.5", i_know=True)
        report = await outcome(fleet, GANTRY)
        assert report.state == "failed"
        assert "axis y has moved by" in report.reason
        assert fleet.controllers["gantry"].position("Y") < 25_000

    run_fleet(main, changed(demo_fleet(), gantry={"state": {"moving_hz": 20.0}}))


@pytest.mark.parametrize("watched", [True, False])
def test_a_filter_that_another_client_changes_is_found_before_or_after_the_move(
    watched: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By its value before the step is armed; if that is not compared, by the duration, which no green verdict covers."""

    async def find_nothing(*_: object, **__: object) -> tuple[()]:
        return ()

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        await client.send_raw("gantry", "ITX=0.02", i_know=True)
        if watched:
            await fleet.wait_until(lambda states: states["gantry"].mode == "fault")
            assert (await client.status())["gantry"].faults[0].code == "setting-changed"
            assert not any((await client.reset()).values())
            assert (await outcome(fleet, job("[{do: move, by: {gantry.x: 10}}]"))).state == "done"
            return
        report = await outcome(fleet, job("[{do: move, by: {gantry.x: 10}}]"))
        assert report.state == "failed"
        assert "axis x took" in report.reason
        assert not (await client.status())["gantry"].axes["x"].referenced

    if not watched:
        monkeypatch.setattr(SMC4000Driver, "check_settings", find_nothing)
    run_fleet(main)


def test_a_target_beyond_the_counts_of_controllers_is_refused_when_it_is_proposed() -> None:
    wide = {"scale": 10_000_000, "soft_limits": None}

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        before = motions(fleet)
        refused = (await outcome(fleet, job("[{do: move, by: {gantry.x: 300}, speed: 0.001}]"))).steps[-1].refused
        assert refused is not None
        assert (refused.code, motions(fleet)) == ("position-range", before)

    run_fleet(main, changed(demo_fleet(), gantry={"axes": {"x": wide}}))


def test_missing_permits_are_listed_with_their_axes_while_they_are_missing() -> None:
    permit = Permit.model_validate({"input": "gantry.door", "value": False, "axes": ["stage.u"]})

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        await asyncio.sleep(1.0)
        assert (await client.list_jobs()).missing_permits == []
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=False))
        await fleet.wait_until(lambda states: states["gantry"].inputs["door"])
        await asyncio.sleep(0.1)
        (missing,) = (await client.list_jobs()).missing_permits
        assert (missing.name, missing.axes) == ("door-closed", ["stage.u"])
        assert "input gantry.door is active" in missing.text

    run_fleet(main, demo_fleet().model_copy(update={"permits": {"door-closed": permit}}))
