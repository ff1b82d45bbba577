"""Jobs on the virtual demo fleet: what they do, what is refused, and the contents of a report."""

import asyncio
import re

import pytest
from cluster.worlds import PREPARE, changed, demo_fleet, demo_job, job, origin_host_ns, outcome, refusal, run_fleet

from adapters.controller.stops import ControllerStops
from orchestrator.bus.base import BusSample
from orchestrator.bus.memory.bus import MemoryBus
from orchestrator.coordinator.fleet.access import FleetAccess
from orchestrator.coordinator.jobs.run.motion_chain import MotionChain
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Permit
from orchestrator.model.messages import StopMode
from orchestrator.model.queue import QueueTerms, shift_utc
from orchestrator.model.report import LeaseState
from orchestrator.model.state import EstopLatch
from orchestrator.runtime.virtual.fleet import VirtualFleet


def test_the_demo_job_runs_and_its_evidence_contains_the_truth() -> None:
    async def main(fleet: VirtualFleet) -> None:
        report = await outcome(fleet, demo_job())
        assert report.state == "done", report.reason
        assert [step.verdict for step in report.steps if step.do == "move"] == ["green"] * 3
        origin_ns = origin_host_ns(fleet)
        homed = {"gantry": 2, "stage": 3}
        for name, controller in fleet.controllers.items():
            made = iter(controller.commanded_motions[homed[name] :])
            for step in report.steps:
                member = step.members.get(name)
                if member is None:
                    continue
                motions = {motion.axis: motion for _, motion in zip(member.axes, made, strict=False)}
                for axis, evidence in member.evidence.items():
                    motor = fleet.fleet.controllers[name].axes[axis].motors[0]
                    start_ns = motions[motor].start_ns - origin_ns
                    assert evidence.start.earliest_ns <= start_ns <= evidence.start.latest_ns
        line = report.steps[4]
        assert set(line.members) == {"gantry", "stage"}
        assert line.start_skew is not None
        assert line.start_skew.at_most_ns <= 10_000_000
        assert fleet.controllers["gantry"].output_level(1) is False
        # 120 → 180 → 120 mm, 80 → 20 → 80 mm; 6 → 2 → 6 mm.
        assert fleet.controllers["gantry"].position("X") == 120_000
        assert fleet.controllers["gantry"].position("Y") == 80_000
        assert fleet.controllers["stage"].position("1") == 60_000

    run_fleet(main)


@pytest.mark.parametrize(
    ("steps", "code", "text"),
    [
        ("[{do: move, to: {gantry.x: 10}}]", "not-enabled", "gantry.x is not enabled"),
        (
            "[{do: enable, axes: [gantry]}, {do: move, to: {gantry.x: 10}}]",
            "not-referenced",
            "gantry.x is not referenced",
        ),
        ("[{do: home, axes: [gantry]}]", "not-enabled", "gantry.x, gantry.y are not enabled"),
    ],
)
def test_refusals_before_the_fleet_is_prepared(steps: str, code: str, text: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        refused = await refusal(fleet, job(steps))
        assert refused.code == code
        assert text in refused.text
        assert refused.remedy

    run_fleet(main)


@pytest.mark.parametrize(
    ("steps", "code", "text"),
    [
        ("[{do: move, by: {gantry.x: 405}}]", "soft-limit", "target 405 mm is beyond its soft limits -10 to 400 mm"),
        ("[{do: move, to: {gantry.x: 10, stage.u: 1}, max_start_skew: 10 us}]", "start-skew", "predicted start skew"),
        ("[{do: move, to: {gantry.x: 10, stage.u: 1}, start: clock}]", "start-class", "no readable clock to start by"),
        (
            "[{do: wait, input: gantry.door, timeout: 1 s}]",
            "wait-timeout",
            "gantry.door did not become active within 1 s",
        ),
    ],
)
def test_refusals_of_a_prepared_fleet(steps: str, code: str, text: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        report = await outcome(fleet, PREPARE, job(steps))
        assert report.state == "failed"
        refused = report.steps[-1].refused
        assert refused is not None
        assert (refused.code, text in refused.text) == (code, True), refused
        assert all(
            not controller.is_moving(a) for controller in fleet.controllers.values() for a in controller.axis_names
        )

    run_fleet(main)


def test_a_job_that_names_unknown_axes_is_not_accepted() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        for steps, text in (
            (
                "[{do: move, to: {gantry.q: 1}}]",
                "no axis gantry.q; did you mean gantry.y? its axes are: gantry.x, gantry.y, stage.u",
            ),
            ("[{do: output, output: gantry.horn, value: true}]", "no output gantry.horn; its outputs are: gantry.lamp"),
            (
                "[{do: wait, input: stage.x, timeout: 1 s}]",
                "no input stage.x; its inputs are: gantry.door, gantry.touch",
            ),
            ("[{do: home, axes: [nothing]}]", "no axis, group or controller nothing"),
            (
                "[{do: move, to: {gantry.x: 401}}]",
                "steps[0] (move): axis gantry.x: target 401 mm is beyond its soft limits -10 to 400 mm",
            ),
            (
                "[{do: move, by: {gantry.x: 300}}, {do: move, by: {gantry.x: 300}}]",
                "steps[1] (move): axis gantry.x: the moves from step 1 (`steps[0]`) on cover 600 mm; its soft limits are 410 mm apart",
            ),
            ("[{do: move, to: {gantry.x: 10 deg}}]", "deg is a unit of angle"),
        ):
            with pytest.raises(Refusal, match=re.escape(text)):
                await client.submit(job(steps))
        assert (await client.list_jobs()).jobs == []

    run_fleet(main)


def test_the_same_client_key_gives_the_same_job() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        dwell = job("[{do: dwell, duration: 10 ms}]")
        first = await client.submit(dwell, "key-1")
        assert await client.submit(dwell, "key-1") == first
        assert await client.submit(dwell, "key-2") != first
        assert len((await client.list_jobs()).jobs) == 2

    run_fleet(main)


def test_a_client_key_is_that_of_its_user_and_of_one_request() -> None:
    async def main(fleet: VirtualFleet) -> None:
        dwell, other = job("[{do: dwell, duration: 10 ms}]"), job("[{do: dwell, duration: 20 ms}]")
        at_home, away, ben = (fleet.make_client(name) for name in ("anna@192.0.2.1", "anna/ci@2001:db8::1", "ben@lab"))
        first = await at_home.submit(dwell, "nightly-1")
        assert await away.submit(dwell, "nightly-1") == first
        assert await ben.submit(other, "nightly-1") != first
        for client, job_, terms in ((away, other, None), (at_home, dwell, QueueTerms(priority=1))):
            with pytest.raises(Refusal) as refused:
                await client.submit(job_, "nightly-1", terms)
            assert refused.value.code == "key-used" and f"job {first}" in refused.value.remedy
            assert re.search(r"'nightly-1' was used at \S+Z by anna@192.0.2.1 for", refused.value.text)
        # The journal has it: a successor answers the same.
        fleet.kill("coordinator/first")
        fleet.start_coordinator("second")
        await asyncio.sleep(5.0)
        assert await at_home.submit(dwell, "nightly-1") == first
        with pytest.raises(Refusal, match="was used at"):
            await at_home.submit(other, "nightly-1")
        # It is answered also when its terms would be refused now.
        late = QueueTerms(expires=shift_utc(fleet.clock.utc(), 10.0))
        kept = await ben.submit(dwell, "late", late)
        await asyncio.sleep(20.0)
        assert await ben.submit(dwell, "late", late) == kept

    run_fleet(main)


def test_two_requests_with_one_key_at_the_same_time_are_one_job_or_one_is_refused() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client("anna")
        jobs = [job(f"[{{do: dwell, duration: {length} ms}}]") for length in (10, 10, 20)]
        results = await asyncio.gather(*(client.submit(each, "k") for each in jobs), return_exceptions=True)
        refusals = [result for result in results if isinstance(result, Refusal)]
        assert [refusal.code for refusal in refusals] in (["key-used"], ["key-used", "key-used"])
        assert len((await client.list_jobs()).jobs) == 1

    run_fleet(main)


def test_cancel_queued_and_running() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        running = await client.submit(job("[{do: move, to: {gantry.x: 390}, speed: 0.1}]"))
        queued = await client.submit(job("[{do: home, axes: [gantry]}]"))
        await asyncio.sleep(1.0)
        assert (await client.list_jobs()).jobs[0].state == "queued"
        await client.cancel_job(queued)
        await client.cancel_job(running)
        assert (await client.wait_for_job(running)).state == "cancelled"
        assert (await client.wait_for_job(queued)).state == "cancelled"
        await asyncio.sleep(0.5)
        assert not fleet.controllers["gantry"].is_moving("X")
        assert 0 < fleet.controllers["gantry"].position("X") < 390_000
        with pytest.raises(Refusal, match="is cancelled already"):
            await client.cancel_job(queued)

    run_fleet(main)


def test_a_cancellation_that_comes_while_its_job_ends_does_not_cut_the_end_off(monkeypatch: pytest.MonkeyPatch) -> None:
    """The stop has ended the step already when all members have answered it: the job waits for the rest of its axes,
    and switches those off that are on for a job only."""
    drop, stop, ending = MotionChain.drop, FleetAccess.stop_members, asyncio.Event()

    async def drop_slowly(self: MotionChain, reason: str, actor: str) -> None:
        if reason == "its job has ended":
            ending.set()
            await asyncio.sleep(0.05)
        await drop(self, reason, actor)

    async def stop_slowly(self: FleetAccess, members: list[str], mode: StopMode, actor: str, reason: str) -> None:
        await stop(self, members, mode, actor, reason)
        if reason.startswith("cancelled"):
            await ending.wait()

    monkeypatch.setattr(MotionChain, "drop", drop_slowly)
    monkeypatch.setattr(FleetAccess, "stop_members", stop_slowly)

    async def main(fleet: VirtualFleet) -> None:
        client, gantry = fleet.make_client(), fleet.controllers["gantry"]
        await outcome(fleet, PREPARE)
        ending.clear()
        job_id = await client.submit(job("[{do: move, to: {gantry.x: 390, stage.u: 12}, speed: 0.1}]"))
        await asyncio.sleep(2.0)
        assert gantry.is_moving("X")
        await client.cancel_job(job_id)
        report = await client.wait_for_job(job_id)
        assert (report.state, report.reason, len(report.steps)) == ("cancelled", "cancelled by client", 1)
        assert not (await client.status())["gantry"].axes["x"].enabled

    run_fleet(main, changed(demo_fleet(), gantry={"axes": {"x": {"enable": "per_job"}}}))


def test_dry_run_reports_what_would_be_sent() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        steps = "[{do: move, to: {gantry.x: 10, stage.u: 1}}, {do: move, by: {gantry.x: 5, stage.u: -1}}]"
        shown = await fleet.make_client().dry_run(job(steps))
        first, second = shown.steps
        assert first.most_s == first.least_s and first.least_s > 0.1
        assert "PA 10000" in first.commands["gantry"] and "PA 15000" in second.commands["gantry"]
        assert [step.commands["stage"][0].partition(",")[0] for step in shown.steps] == ["MP:1+P10000", "MP:1-P10000"]
        assert not any(c.is_moving(a) for c in fleet.controllers.values() for a in c.axis_names)

    run_fleet(main)


def test_a_dry_run_follows_the_axes_from_step_to_step() -> None:
    """Four moves of 100 mm from 50 mm: the fourth leaves the soft limits, which the present position does not show."""
    done: list[int] = []

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        prepared = await client.dry_run(job("[{do: move, to: {gantry.x: 10}}]"))
        assert [problem.code for problem in prepared.problems] == ["not-enabled", "not-referenced"]
        whole = "{do: enable, axes: [gantry]}, {do: home, axes: [gantry]}, {do: move, to: {gantry.x: 50}}"
        good = await client.dry_run(job(f"[{whole}]"))
        assert not good.problems and "PA 50000" in good.steps[2].commands["gantry"]
        shown = await client.dry_run(job(f"[{whole}" + ", {do: move, by: {gantry.x: 100}}" * 4 + "]"))
        (problem,) = shown.problems
        assert (problem.place, problem.code) == (["steps", 6, "by", "gantry.x"], "soft-limit")
        back = ", ".join(f"{{do: move, to: {{gantry.x: {k % 2}}}}}" for k in range(120))
        long = await client.dry_run(job(f"[{whole}, {back}]"), done.append)
        assert len(long.steps) == 123 and done == [50, 100, 123] and not long.problems
        assert not any(c.is_moving(a) for c in fleet.controllers.values() for a in c.axis_names)

    run_fleet(main)


def test_a_dry_run_beside_an_offline_controller_says_which_was_not_asked() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        fleet.wires["stage"].cut = True
        await fleet.wait_until(lambda states: states["stage"].mode == "offline")
        shown = await fleet.make_client().dry_run(
            job("[{do: move, to: {gantry.x: 10, stage.u: 1}}, {do: move, to: {gantry.x: 20}}]")
        )
        assert shown.problems == [] and "stage" in " ".join(shown.conditions)
        assert not shown.steps[0].commands and "PA 20000" in shown.steps[1].commands["gantry"]

    run_fleet(main)


@pytest.mark.parametrize(("axis", "other"), [("stage.u", "gantry"), ("gantry.x", "stage")])
def test_moving_controllers_receive_an_estop_before_those_at_rest(
    monkeypatch: pytest.MonkeyPatch, axis: str, other: str
) -> None:
    told: list[str] = []
    estop = ControllerStops.apply_estop

    async def noted(unit: ControllerStops, latch: EstopLatch) -> None:
        told.append(unit._context.controller)  # pyright: ignore[reportPrivateUsage]
        await estop(unit, latch)

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        mover = axis.partition(".")[0]
        client = fleet.make_client()
        await client.submit(job(f"[{{do: move, to: {{{axis}: 40}}, speed: 0.1}}]"))
        await fleet.wait_until(lambda states: states[mover].mode == "moving")
        monkeypatch.setattr(ControllerStops, "apply_estop", noted)
        await client.estop("a test")
        assert told == [mover, other]

    run_fleet(main)


def test_estop_latches_everywhere_and_survives_a_restarted_host() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        moving = await client.submit(job("[{do: move, to: {gantry.x: 390, stage.u: 40}, speed: 0.2}]"))
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        await asyncio.sleep(0.6)
        latched = await client.estop("a test")
        assert latched == {"gantry": True, "stage": True}
        assert (await client.wait_for_job(moving)).state in ("aborted", "failed")
        fleet.kill("host/local")
        states = await fleet.wait_until(lambda states: all(s.mode in ("idle", "fault") for s in states.values()))
        assert all(state.estop is not None and state.estop.reason == "a test" for state in states.values())
        assert (await refusal(fleet, job("[{do: home, axes: [gantry]}]"))).code == "estop-latched"
        await client.reset()
        states = await client.status()
        assert all(state.estop is None for state in states.values())

    run_fleet(main)


def test_an_absent_controller_is_reported_with_its_remedy() -> None:
    async def main(fleet: VirtualFleet) -> None:
        fleet.wires["stage"].cut = True
        states = await fleet.wait_until(lambda states: states["stage"].mode == "offline")
        assert states["stage"].faults[0].remedy
        assert (await refusal(fleet, job("[{do: move, to: {stage.u: 1}}]"))).code == "offline"
        fleet.wires["stage"].cut = False
        await fleet.wait_until(lambda states: states["stage"].mode == "idle")

    run_fleet(main)


def test_a_second_coordinator_is_refused_and_a_fleet_file_that_differs_too() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, PREPARE)).state == "done"
        fleet.start_coordinator("second")
        await asyncio.sleep(2.0)
        assert any(
            "leads fleet demo (epoch 1); stop it first, or start with --take-over" in line for line in fleet.lines
        )
        other = demo_fleet()
        gantry = other.controllers["gantry"].model_copy(update={"options": {"decode_us": 700}})
        fleet.fleet = other.model_copy(update={"controllers": other.controllers | {"gantry": gantry}})
        fleet.start_coordinator("third", take_over=True)
        await asyncio.sleep(3.0)
        report = await outcome(fleet, job("[{do: home, axes: [gantry]}]"))
        assert report.state == "failed" and "gantry: the coordinator uses configuration" in report.reason
        await fleet.wait_until(lambda states: states["gantry"].axes["x"].enabled)
        shown = await fleet.make_client().dry_run(job("[{do: move, to: {gantry.x: 1}}]"))
        assert [problem.code for problem in shown.problems] == ["other-configuration"]

    run_fleet(main)


def test_relative_moves_there_and_back_end_on_the_same_count() -> None:
    async def main(fleet: VirtualFleet) -> None:
        there, back = "{do: move, by: {stage.u: '33.3333 um'}}", "{do: move, by: {stage.u: '-33.3333 um'}}"
        await outcome(fleet, PREPARE)
        before = fleet.controllers["stage"].position("1")
        report = await outcome(fleet, job("[" + ", ".join([there, back] * 30 + [there] * 3 + [back] * 3) + "]"))
        assert report.state == "done", report.reason
        assert fleet.controllers["stage"].position("1") == before

    run_fleet(main)


def test_data_in_the_answer_to_a_lease_is_not_requested_again(monkeypatch: pytest.MonkeyPatch) -> None:
    asked: list[str] = []
    request = MemoryBus.request

    async def noted(self: MemoryBus, key: str, payload: bytes, timeout_s: float, server: str | None = None) -> bytes:
        asked.append(key)
        return await request(self, key, payload, timeout_s, server)

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        monkeypatch.setattr(MemoryBus, "request", noted)
        steps = "[{do: move, by: {gantry.x: 1, stage.u: 1}}, {do: move, by: {gantry.x: 1, stage.u: 1}}]"
        report = await outcome(fleet, job(steps, max_start_skew="50 ms"))
        assert report.state == "done", report.reason
        states = [key for key in asked if key in (fleet.keys.state("gantry"), fleet.keys.state("stage"))]
        # Nor before the second step, which is planned from where the first one ends.
        assert not states
        assert len([key for key in asked if key.endswith("/lease")]) >= 2

    run_fleet(main)


def test_enabling_by_policy_and_leases_on_the_bus() -> None:
    base = demo_fleet()
    policies = {"gantry": "per_job", "stage": "at_start"}
    controllers = {
        name: config.model_copy(
            update={"axes": {a: axis.model_copy(update={"enable": policies[name]}) for a, axis in config.axes.items()}}
        )
        for name, config in base.controllers.items()
    }

    async def main(fleet: VirtualFleet) -> None:
        states = await fleet.wait_until(lambda states: all(a.enabled for a in states["stage"].axes.values()))
        assert not any(axis.enabled for axis in states["gantry"].axes.values())
        client, holders = fleet.make_client(), list[tuple[str, bool]]()

        def receive(sample: BusSample) -> None:
            lease = LeaseState.model_validate_json(sample.payload)
            if lease.what.startswith("job"):
                holders.append((lease.controller, lease.holder is not None))

        await client.bus.subscribe(client.keys.leases, receive)
        report = await client.wait_for_job(
            await client.submit(job("[{do: home}, {do: move, to: {gantry.x: 5, stage.u: 1}}]"))
        )
        assert report.state == "done", report.reason
        # In order for each key; no more is promised.
        for controller in policies:
            assert [held for each, held in holders if each == controller] == [True, False]
        states = await client.status()
        assert not any(axis.enabled for axis in states["gantry"].axes.values())
        assert all(axis.enabled for axis in states["stage"].axes.values())

    run_fleet(main, base.model_copy(update={"controllers": controllers}))


def test_an_estop_takes_outputs_to_their_safe_state() -> None:
    async def main(fleet: VirtualFleet) -> None:
        assert (await outcome(fleet, job("[{do: output, output: gantry.lamp, value: true}]"))).state == "done"
        assert fleet.controllers["gantry"].output_level(1)
        await fleet.make_client().estop()
        await asyncio.sleep(0.5)
        assert not fleet.controllers["gantry"].output_level(1)

    run_fleet(main)


def test_the_trace_shows_the_fired_line_in_its_place() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE, job("[{do: move, to: {stage.u: 1}}]"))
        entries = (await fleet.make_client().read_trace("stage")).entries
        assert [text for _, direction, text in entries if direction == "out" and text.startswith("G:")] == ["G:1\r\n"]
        assert [at_ns for at_ns, _, _ in entries] == sorted(at_ns for at_ns, _, _ in entries)

    run_fleet(main)


def test_a_permit_must_hold_to_arm_and_its_loss_stops_the_step() -> None:
    closed = Permit(input="gantry.door", value=False, axes=["table"])

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        # The door's input is active when it is low: open is low.
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=False))
        await fleet.wait_until(lambda states: states["gantry"].inputs["door"])
        refused = await refusal(fleet, job("[{do: move, to: {stage.u: 10}}]"))
        assert (refused.code, refused.text) == (
            "permit",
            "permit door-closed does not hold: input gantry.door is active",
        )
        assert (await outcome(fleet, job("[{do: move, to: {stage.focus: 100}}]"))).state == "done"
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=True))
        await fleet.wait_until(lambda states: not states["gantry"].inputs["door"])
        moving = await client.submit(job("[{do: move, to: {gantry.x: 390, stage.u: 40}, speed: 0.2}]"))
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        await asyncio.sleep(1.0)
        lost_ns = fleet.clock.now_ns()
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=False))
        report = await client.wait_for_job(moving)
        assert report.state == "failed"
        assert "permit door-closed" in report.reason
        await asyncio.sleep(1.0)
        ends_ns = [motion.end_ns for each in fleet.controllers.values() for motion in each.commanded_motions[-1:]]
        # One poll of the gantry (100 ms), the latency to the coordinator and of the stops, then ramps of 0.2 s at most.
        assert all(end_ns is not None and end_ns - lost_ns < 500_000_000 for end_ns in ends_ns)

    run_fleet(main, demo_fleet().model_copy(update={"permits": {"door-closed": closed}}))


def test_an_override_slows_the_moves_that_follow() -> None:
    """Between steps: the present move goes on as it was planned, and what is prepared behind it is planned anew."""

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        steps = "[{do: move, to: {gantry.x: 100}, speed: 0.2}, {do: move, to: {gantry.x: 0}, speed: 0.2}]"
        moving = await client.submit(job(steps))
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        with pytest.raises(Refusal, match="cannot be faster"):
            await client.override_job(moving, 110)
        await client.override_job(moving, 50)
        report = await client.wait_for_job(moving)
        first, second = (step.planned_s for step in report.steps)
        assert first is not None and second is not None
        assert second == pytest.approx(2 * first, rel=0.1)
        await outcome(fleet, job("[{do: move, to: {gantry.x: 100}, speed: 0.2}]"))

    run_fleet(main)


def test_a_dwell_that_counts_from_the_beginning_waits_for_what_is_left() -> None:
    async def main(fleet: VirtualFleet) -> None:
        begun_ns = fleet.clock.now_ns()
        report = await outcome(
            fleet,
            job(
                "[{do: dwell, duration: 3 s}, {do: dwell, duration: 5 s, since_begin: true}, "
                "{do: dwell, duration: 2 s, since_begin: true}]"
            ),
        )
        assert report.state == "done"
        assert [step.actual_s for step in report.steps] == pytest.approx([3, 2, 0], abs=0.1)
        assert fleet.clock.now_ns() - begun_ns < 6_000_000_000

    run_fleet(main)
