"""Axes under manual control: a jog lives while it is renewed and ends by itself, whichever other process dies or
hangs."""

import asyncio
from collections.abc import Callable

import pytest
from cluster.worlds import PREPARE, changed, demo_fleet, job, outcome, refusal, run_fleet

from orchestrator.client.api import Tutti
from orchestrator.client.manual import ManualControl
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Permit
from orchestrator.model.messages import JogRequest, Reply
from orchestrator.model.report import LeaseState
from orchestrator.runtime.virtual.fleet import VirtualFleet

# By axis: its controller, its motor, counts per unit, and the speed it is jogged at, unit/s.
AXES = {"gantry.x": ("gantry", "X", 1000, 20.0), "stage.u": ("stage", "1", 10_000, 1.0)}
VALID_NS = 200 * NS_PER_MS
# From silence to rest, at the jogged speeds: the deadline, the latency of the stop, a ramp of at most 20 ms, one poll.
RESTS_NS = VALID_NS + 60 * NS_PER_MS


class Jogged:
    """One axis of a fleet, held and jogged."""

    def __init__(self, fleet: VirtualFleet, axis: str) -> None:
        self.fleet = fleet
        self.axis = axis
        self.controller, self.motor, self.scale, self.speed = AXES[axis]

    @property
    def moving(self) -> bool:
        return self.fleet.controllers[self.controller].is_moving(self.motor)

    @property
    def position(self) -> float:
        return self.fleet.controllers[self.controller].position(self.motor) / self.scale

    @property
    def end_ns(self) -> int:
        """When its last motion came to rest."""
        ends = [m.end_ns for m in self.fleet.controllers[self.controller].commanded_motions if m.axis == self.motor]
        assert ends[-1] is not None
        return ends[-1]

    async def hold(self, hand: ManualControl, seconds: float, velocity: float | None = None) -> None:
        """Hold the key."""
        await hand.jog({self.axis: self.speed if velocity is None else velocity})
        for _ in range(round(seconds / 0.05)):
            await asyncio.sleep(0.05)
            await hand.renew_jog()

    async def rest(self) -> None:
        """Wait until it is at rest."""
        while self.moving:
            await asyncio.sleep(0.005)


@pytest.mark.parametrize("axis", AXES)
def test_an_axis_moves_while_the_key_is_held_and_stops_when_it_is_released(axis: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        jogged, client = Jogged(fleet, axis), fleet.make_client("anna")
        async with client.manual_control([axis], what="alignment") as hand:
            before = jogged.position
            await jogged.hold(hand, 1.0)
            assert jogged.position - before == pytest.approx(jogged.speed, rel=0.1)
            states = await client.status()
            assert states[jogged.controller].mode == "jogging"
            assert set(states[jogged.controller].leases.values()) == {hand.holder}
            let_go_ns = fleet.clock.now_ns()
            await hand.stop()
            await jogged.rest()
            assert jogged.end_ns - let_go_ns < 60 * NS_PER_MS
            await jogged.hold(hand, 0.5, -jogged.speed / 2)
            assert fleet.controllers[jogged.controller].velocity(jogged.motor) < 0
        await jogged.rest()
        await fleet.wait_until(lambda states: states[jogged.controller].mode == "idle")
        assert not (await client.status())[jogged.controller].leases
        report = await outcome(fleet, job(f"[{{do: move, to: {{{axis}: 5}}}}]"))
        assert report.state == "done", report.reason

    run_fleet(main)


@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("seed", range(3))
def test_silence_stops_the_axis_in_its_adapter(axis: str, seed: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        jogged, client = Jogged(fleet, axis), fleet.make_client()
        async with client.manual_control([axis]) as hand:
            await jogged.hold(hand, 0.6 + 0.07 * seed)
            silent_ns = fleet.clock.now_ns()
            await asyncio.sleep(0.15)
            assert jogged.moving
            await jogged.rest()
            assert VALID_NS - 20 * NS_PER_MS < jogged.end_ns - silent_ns < RESTS_NS
            with pytest.raises(Refusal, match="not renewed in time") as caught:
                await hand.renew_jog()
            assert caught.value.code == "not-jogging"

    run_fleet(main, seed=seed)


def test_an_unreferenced_axis_may_only_creep() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job("[{do: enable, axes: [gantry, stage]}]"))
        jogged, client = Jogged(fleet, "gantry.x"), fleet.make_client()
        async with client.manual_control(["gantry.x"]) as hand:
            with pytest.raises(Refusal, match=r"may jog at 4 mm/s at most while it is not referenced") as caught:
                await hand.jog({"gantry.x": 4.1})
            assert caught.value.code == "too-fast"
            assert not jogged.moving
            before = jogged.position
            # Soft limits mean nothing yet: the axis may be moved beyond where they would be.
            for _ in range(5):
                await jogged.hold(hand, 1.0, -4.0)
            assert jogged.position - before < -15

    run_fleet(main)


@pytest.mark.parametrize("axis", AXES)
def test_a_jog_ends_at_the_soft_limit_and_leads_back_from_it(axis: str) -> None:
    base = demo_fleet()
    near = changed(
        base,
        gantry={"axes": {"x": {"soft_limits": {"min": -10, "max": 12.345}}}},
        stage={"axes": {"u": {"soft_limits": {"min": -1, "max": 0.7}}}},
    )

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        jogged, client = Jogged(fleet, axis), fleet.make_client()
        end = 12.345 if axis == "gantry.x" else 0.7
        async with client.manual_control([axis]) as hand:
            with pytest.raises(Refusal, match="soft limit") as caught:
                await jogged.hold(hand, 3.0)
            assert caught.value.code == "not-jogging"
            assert jogged.position == pytest.approx(end, abs=1e-9)
            with pytest.raises(Refusal, match="is at its soft limit") as caught:
                await hand.jog({axis: jogged.speed})
            assert caught.value.code == "soft-limit"
            assert caught.value.remedy == "jog in the other direction"
            await jogged.hold(hand, 0.3, -jogged.speed)
            assert jogged.position < end

    run_fleet(main, near)


def test_limits_that_were_tightened_below_the_axis_let_it_only_back() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE, job("[{do: move, to: {gantry.x: 3}}]"))
        tight = changed(demo_fleet(), gantry={"axes": {"x": {"soft_limits": {"min": -20, "max": -5}}}})
        await client.reload_fleet(tight)
        assert (await outcome(fleet, PREPARE)).state == "done"  # homed to 0, beyond the limit at -5
        jogged = Jogged(fleet, "gantry.x")
        async with client.manual_control(["gantry.x"]) as hand:
            with pytest.raises(Refusal, match="soft limit"):
                await hand.jog({"gantry.x": 5})
            assert not jogged.moving
            await jogged.hold(hand, 0.5, -5)
            assert jogged.position < -1
        await fleet.wait_until(lambda states: states["gantry"].mode == "idle")
        report = await outcome(fleet, job("[{do: move, to: {gantry.x: -10}}]"))
        assert report.state == "done", report.reason

    run_fleet(main)


def test_an_axis_that_was_pushed_while_off_is_read_at_its_true_position() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE, job("[{do: move, to: {gantry.x: 5, stage.u: 1}}]"))
        await outcome(fleet, job("[{do: disable, axes: [gantry, stage]}]"))
        fleet.act_on_controller("gantry", lambda gantry: gantry.push_axis("X", 2500))
        fleet.act_on_controller("stage", lambda stage: stage.push_axis("1", 300))
        states = await fleet.wait_until(lambda states: states["gantry"].axes["x"].raw_counts == 7500)
        # The gantry's encoder has measured it; a stepper without one cannot, and does not pretend to.
        assert states["gantry"].axes["x"].referenced
        assert not any(axis.referenced for axis in states["stage"].axes.values())
        await outcome(fleet, job("[{do: enable, axes: [gantry, stage]}]"))
        assert (await outcome(fleet, job("[{do: move, to: {gantry.x: 5}}]"))).state == "done"
        assert fleet.controllers["gantry"].position("X") == 5000
        assert (await refusal(fleet, job("[{do: move, to: {stage.u: 1}}]"))).code == "not-referenced"

    run_fleet(main)


# Which clients may move it


def test_two_leases_on_one_axis_conflict_and_a_job_runs_next_to_a_lease() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        anna, ben = fleet.make_client("anna"), fleet.make_client("ben")
        async with anna.manual_control(["gantry.x"], what="jog panel") as hand:
            await hand.jog({"gantry.x": 5.0})
            with pytest.raises(Refusal, match=r"gantry\.x is in use by anna \(jog panel\)") as caught:
                await ben.manual_control(["gantry.x"]).acquire()
            assert caught.value.code == "leased"
            assert fleet.controllers["gantry"].is_moving("X"), "a refused request ends no jog"
            await hand.stop()
            # The gantry's axes cannot be separated: the lease includes y, too. The stage is free.
            assert hand.axes == ["gantry.x", "gantry.y"]
            async with ben.manual_control(["stage.u"]) as other:
                await other.jog({"stage.u": 0.5})
                # A client that comes later queries the leases.
                leases = (await ben.bus.request_all(ben.keys.leases, b"", timeout_s=1.0)).values()
                found = {each.controller: each.actor for each in map(LeaseState.model_validate_json, leases)}
                assert found == {"gantry": "anna", "stage": "ben"}
            waiting = await ben.submit(job("[{do: move, to: {gantry.y: 5}}]"))
            await asyncio.sleep(0.1)
            shown = (await ben.show_job(waiting)).entry
            assert shown is not None
            assert (shown.state, shown.reason) == ("queued", "waits for gantry: in use by anna (jog panel)")
            # A command that bypasses the service is refused by the adapter itself.
            with pytest.raises(Refusal, match="is leased to anna"):
                await jog_anyhow(ben, "gantry", {"x": 5.0}, "manual-ben", 1)
        assert (await ben.wait_for_job(waiting)).state == "done"
        moving = await anna.submit(job("[{do: move, to: {gantry.x: 100}, speed: 0.2}]"))
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        with pytest.raises(Refusal, match=r"gantry\.x is in use by anna \(job 'test'\)"):
            await ben.manual_control(["gantry.x"]).acquire()
        with pytest.raises(Refusal, match="is leased to anna"):
            await jog_anyhow(ben, "gantry", {"x": 5.0}, "manual-ben", 1)
        assert (await anna.wait_for_job(moving)).state == "done"
        with pytest.raises(Refusal, match="axis x is not leased to manual-ben"):
            await jog_anyhow(ben, "gantry", {"x": 5.0}, "manual-ben", 2)

    run_fleet(main)


async def jog_anyhow(client: Tutti, controller: str, velocities: dict[str, float], holder: str, seq: int) -> None:
    request = JogRequest(**client.request_fields(), holder=holder, seq=seq, velocities=velocities)
    await client.request_controller(controller, "jog", request, Reply)


def test_an_obsolete_request_moves_nothing() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client, jogged = fleet.make_client(), Jogged(fleet, "gantry.x")
        async with client.manual_control(["gantry.x"]) as hand:
            await jog_anyhow(client, "gantry", {"x": 5.0}, hand.holder, 7)
            await jog_anyhow(client, "gantry", {"x": 0.0}, hand.holder, 9)
            with pytest.raises(Refusal, match="request 8 came after request 9"):
                await jog_anyhow(client, "gantry", {"x": 5.0}, hand.holder, 8)
            await jogged.rest()
            await asyncio.sleep(0.3)
            assert not jogged.moving

    run_fleet(main)


def test_the_lease_of_a_client_that_vanishes_expires() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client, jogged = fleet.make_client("anna"), Jogged(fleet, "gantry.x")
        hand = client.manual_control(["gantry.x"])
        await hand.acquire()
        await jogged.hold(hand, 0.3)
        fleet.net.kill_process(client.bus.name)  # type: ignore[attr-defined]
        killed_ns = fleet.clock.now_ns()
        await jogged.rest()
        assert jogged.end_ns - killed_ns < RESTS_NS
        await fleet.wait_until(lambda states: not states["gantry"].leases, limit_s=10)
        assert fleet.clock.now_ns() - killed_ns < 6 * NS_PER_S
        async with fleet.make_client("ben").manual_control(["gantry.x"]) as other:
            await other.jog({"gantry.x": 5.0})

    run_fleet(main)


# What ends it

Act = Callable[[VirtualFleet, Tutti], None]


async def stop_all(fleet: VirtualFleet) -> None:
    await fleet.make_client("carl").stop()


async def estop(fleet: VirtualFleet) -> None:
    await fleet.make_client("carl").estop()


async def open_door(fleet: VirtualFleet) -> None:
    fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=False))


async def limit(fleet: VirtualFleet) -> None:
    fleet.act_on_controller("gantry", lambda gantry: gantry.set_limit("X", "forward"))


async def kill_host(fleet: VirtualFleet) -> None:
    fleet.kill("host/local")


async def hang_host(fleet: VirtualFleet) -> None:
    fleet.freeze("host/local")


async def kill_coordinator(fleet: VirtualFleet) -> None:
    fleet.kill("coordinator/first")


async def hang_coordinator(fleet: VirtualFleet) -> None:
    fleet.freeze("coordinator/first")


@pytest.mark.parametrize(
    ("act", "rests_s", "codes"),
    [
        (stop_all, 0.1, ["not-jogging"]),
        (estop, 0.1, ["estop-latched"]),
        (open_door, 0.25, ["not-leased"]),  # one poll at 10 Hz, and the latency to the coordinator and back
        (limit, 0.1, ["not-jogging"]),
        (kill_host, 0.5, []),
        (hang_host, 0.5, []),
        # By the adapter, or by the client's own renewal of its lease, whichever misses the coordinator first.
        (kill_coordinator, 0.8, ["not-leased", "no-coordinator"]),
        (hang_coordinator, 0.8, ["not-leased"]),
    ],
)
def test_a_jog_ends_although_the_key_is_held(
    act: Callable[[VirtualFleet], object], rests_s: float, codes: list[str]
) -> None:
    closed = Permit(input="gantry.door", value=False)
    guarded = demo_fleet().model_copy(update={"permits": {"door-closed": closed}})

    async def main(fleet: VirtualFleet) -> None:
        fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=True))
        await fleet.wait_until(lambda states: not states["gantry"].inputs["door"])
        assert (await outcome(fleet, PREPARE)).state == "done"
        jogged, client = Jogged(fleet, "gantry.x"), fleet.make_client("anna")
        hand = client.manual_control(["gantry.x"])
        await hand.acquire()
        await jogged.hold(hand, 0.5)
        began_ns = fleet.clock.now_ns()
        await act(fleet)  # type: ignore[misc]
        refusal = None
        while fleet.clock.now_ns() < began_ns + 2 * NS_PER_S:
            try:
                await hand.renew_jog()
            except Refusal as error:
                refusal = error
                if error.code in codes:
                    break
            await asyncio.sleep(0.05)
        assert refusal is not None
        assert not codes or refusal.code in codes, refusal
        await jogged.rest()
        assert jogged.end_ns - began_ns < rests_s * NS_PER_S
        before = jogged.position
        await asyncio.sleep(0.5)
        assert jogged.position == before
        await hand.release()

    run_fleet(main, guarded)


def test_a_controller_that_loses_power_in_a_jog() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        jogged, client = Jogged(fleet, "stage.u"), fleet.make_client()
        async with client.manual_control(["stage.u"]) as hand:
            await jogged.hold(hand, 0.5)
            fleet.act_on_controller("stage", lambda stage: stage.set_power(on=False))
            await asyncio.sleep(0.3)
            fleet.act_on_controller("stage", lambda stage: stage.set_power(on=True))
            assert not jogged.moving
            await fleet.wait_until(
                lambda states: (
                    states["stage"].mode == "idle"
                    and not any(axis.referenced for axis in states["stage"].axes.values())
                )
            )
            with pytest.raises(Refusal):
                await hand.renew_jog()

    run_fleet(main)


def test_a_raw_command_needs_a_flag_and_a_lease_on_the_axes() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client("anna")
        assert (await client.send_raw("gantry", "MG 6*7", i_know=True)).strip() == "0000000042.0000"
        with pytest.raises(Refusal, match="not checked against any limit"):
            await client.send_raw("gantry", "MG 6*7", i_know=False)
        moving = await client.submit(job("[{do: move, to: {gantry.x: 100}, speed: 0.2}]"))
        await fleet.wait_until(lambda states: states["gantry"].mode == "moving")
        with pytest.raises(Refusal, match=r"in use by anna \(job 'test'\)"):
            await client.send_raw("gantry", "STX", i_know=True)
        assert (await client.wait_for_job(moving)).state == "done"
        assert any("raw by anna: 'MG 6*7'" in line for line in fleet.lines)

    run_fleet(main)
