"""A move of an SMC-4000 or an SMC-2000 that is sent farther on the way."""

from typing import Any

import pytest
from cluster.test_retarget import LimitWatch, begin, position, raises_refusal, wait_for_state
from cluster.worlds import PREPARE, job, line_fleet, outcome, run_fleet

from adapters.yaskawa.wire.exchange import SmcCommandRefused
from adapters.yaskawa.wire.session import CommandSession
from orchestrator.clock.base import NS_PER_S, sleep_ns
from orchestrator.model.report import StepReport
from orchestrator.runtime.virtual.fleet import VirtualFleet

MAKES = {"gantry": 0.7, "outlet": 2.0}  # how long after the request it moves, s: loading takes longer on a serial line


def send_farther(name: str, by: tuple[float, float], after_s: float, speed: float = 0.4) -> StepReport:
    """Move an axis by these times its limit of velocity, s, the second one given on the way; the report of its step."""

    async def main(fleet: VirtualFleet) -> StepReport:
        axis = f"{name}.x"
        await outcome(fleet, job(f"[{{do: enable, axes: [{name}]}}, {{do: home, axes: [{axis}]}}]"))
        velocity, scale = fleet.fleet.axis(axis).limits.velocity, float(fleet.fleet.axis(axis).scale)
        if by[0] < 0.0:
            assert (await outcome(fleet, job(f"[{{do: move, by: {{{axis}: {velocity}}}}}]"))).state == "done"
        here = position(fleet, axis)
        steps = f"[{{do: move, by: {{{axis}: {by[0] * velocity}}}, speed: {speed}}}]"
        _, submitted = await begin(fleet, steps, after_s)
        watch = LimitWatch(fleet, [axis])
        reply = await submitted.retarget(by={axis: by[1] * velocity})
        report = await submitted.result()
        watch.close()
        assert report.state == "done", report.reason
        assert reply.way == report.steps[0].retargets[0].way
        assert position(fleet, axis) - here == pytest.approx(sum(by) * velocity, abs=1.01 / scale)
        assert not watch.problems, watch.problems[:5]
        assert watch.fastest[axis] <= speed * velocity * 1.001
        return report.steps[0]

    return run_fleet(main, line_fleet(name))


@pytest.mark.parametrize("sign", [1, -1])
@pytest.mark.parametrize("name", MAKES)
def test_a_move_is_sent_farther_without_a_rest(name: str, sign: int) -> None:
    step = send_farther(name, (0.4 * sign, 0.2 * sign), MAKES[name], 0.2)
    assert step.retargets[0].way == "extend" and step.verdict == "green", step.deviations
    assert step.planned_s == pytest.approx(0.6 / 0.2 + 0.04, abs=0.01)  # as one move to the new target
    assert step.actual_s == pytest.approx(step.planned_s, abs=0.01)


@pytest.mark.parametrize("name", MAKES)
def test_it_brakes_for_a_nearer_target(name: str) -> None:
    assert send_farther(name, (0.8, -0.2), MAKES[name], 0.2).retargets[0].way == "brake"


@pytest.mark.parametrize("name", MAKES)
def test_once_it_brakes_or_is_about_to_it_is_not_sent_farther(name: str) -> None:
    ways = {send_farther(name, (0.4, 0.2), MAKES[name] + ms / 1000).retargets[0].way for ms in range(220, 360, 20)}
    assert "brake" in ways


def test_axes_that_move_together_brake_together() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        _, submitted = await begin(fleet, "[{do: move, to: {gantry.x: 200, gantry.y: 60}, speed: 0.3}]")
        reply = await submitted.retarget({"gantry.x": 250, "gantry.y": 80})
        assert (reply.way, (await submitted.result()).state) == ("brake", "done")
        assert position(fleet, "gantry.x") == pytest.approx(250, abs=1e-3)

    run_fleet(main)


def test_again_and_again_and_the_step_behind_it_follows() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        info = await fleet.make_client().axis("gantry.x")
        assert info.retarget.way == "extend" and 0.0 < info.retarget.within_s < 0.1
        steps = "[{do: move, to: {gantry.x: 100}, speed: 0.3}, {do: move, by: {gantry.x: 7}}]"
        _, submitted = await begin(fleet, steps)
        for target in (120, 150, 151):
            assert (await submitted.retarget({"gantry.x": target})).way == "extend"
            await sleep_ns(fleet.clock, NS_PER_S // 5)
        report = await submitted.result()
        assert report.state == "done", report.reason
        assert position(fleet, "gantry.x") == pytest.approx(158, abs=1e-3)
        first, second = report.steps
        assert [entry.to for entry in first.retargets] == [{"gantry.x": x} for x in (120, 150, 151)]
        assert first.verdict == second.verdict == "green", (first.deviations, second.deviations)
        assert second.chain is not None and second.chain.step == 0

    run_fleet(main)


def test_it_does_not_go_beyond_a_soft_limit() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        _, submitted = await begin(fleet, "[{do: move, to: {gantry.x: 200}, speed: 0.3}]")
        with raises_refusal("soft-limit"):
            await submitted.retarget({"gantry.x": 100_000})
        assert (await submitted.result()).state == "done"
        assert position(fleet, "gantry.x") == pytest.approx(200, abs=1e-3)

    run_fleet(main)


@pytest.mark.parametrize("what", ["pause", "stop", "estop"])
def test_what_stops_a_step_stops_one_that_was_sent_farther(what: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client, submitted = await begin(fleet, "[{do: move, to: {gantry.x: 100}, speed: 0.3}]")
        assert (await submitted.retarget({"gantry.x": 150})).way == "extend"
        if what == "pause":
            await submitted.pause(now=True)
            await wait_for_state(fleet, submitted, "paused")
            await submitted.resume()
            assert (await submitted.result()).state == "done"
            assert position(fleet, "gantry.x") == pytest.approx(150, abs=1e-3)
            return
        await (client.stop() if what == "stop" else client.estop())
        assert (await submitted.result()).state in ("aborted", "failed")
        stands = position(fleet, "gantry.x")
        await sleep_ns(fleet.clock, 3 * NS_PER_S)
        assert position(fleet, "gantry.x") == pytest.approx(stands, abs=0.01)
        assert stands < 140

    run_fleet(main)


@pytest.mark.parametrize("what", ["refused", "stopped before", "ended before"])
def test_what_the_controller_does_not_take_changes_nothing(monkeypatch: pytest.MonkeyPatch, what: str) -> None:
    send = CommandSession.send_command

    async def main(fleet: VirtualFleet) -> None:
        async def disturb(session: CommandSession, command: str, *rest: Any) -> None:
            if command.startswith("IP ") and what == "refused":
                raise SmcCommandRefused(command, 16, "IP incorrect sign during position move")
            if command.startswith("IP "):
                if what == "stopped before":
                    session.write_at_once("STX")
                await sleep_ns(fleet.clock, (1 if what == "stopped before" else 9) * NS_PER_S)
            await send(session, command, *rest)

        await outcome(fleet, PREPARE)
        _, submitted = await begin(fleet, "[{do: move, to: {gantry.x: 100}, speed: 0.3}]")
        monkeypatch.setattr(CommandSession, "send_command", disturb)
        watch = LimitWatch(fleet, ["gantry.x"])
        if what == "refused":
            assert (await submitted.retarget({"gantry.x": 150})).way == "brake"
            assert (await submitted.result()).state == "done"
            assert position(fleet, "gantry.x") == pytest.approx(150, abs=1e-3)
        else:
            with raises_refusal("not-moving"):
                await submitted.retarget({"gantry.x": 150})
            await submitted.result()
            # IP for an axis at rest would be a move of its own.
            assert position(fleet, "gantry.x") <= 100.001
        watch.close()
        assert not watch.problems, watch.problems[:5]

    run_fleet(main)
