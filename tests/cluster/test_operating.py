"""Functions for commissioning a machine: motors and brakes, permits, coordinates, configuration, reset."""

import asyncio
from fractions import Fraction

import pytest
from cluster.worlds import PREPARE, changed, demo_fleet, job, outcome, refusal, run_fleet

from adapters.controller.state.store import AdapterMemory, FileStore
from adapters.yaskawa.smc4000.driver import SMC4000Driver
from orchestrator.clock.base import NS_PER_S
from orchestrator.link.memory import MemoryLink
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet, Permit
from orchestrator.model.queue import QueueTerms
from orchestrator.model.state import ControllerState
from orchestrator.runtime.virtual.fleet import VirtualFleet

DOOR = Permit(input="gantry.door", value=False, axes=["table"])
TEN_S = job("[{do: move, to: {gantry.x: 390, stage.u: 40}, speed: 0.2}]")


def guarded(permit: Permit = DOOR) -> Fleet:
    return demo_fleet().model_copy(update={"permits": {"door-closed": permit}})


def set_door(fleet: VirtualFleet, is_open: bool) -> None:
    """The door's input is active, and low, while it is open."""
    fleet.act_on_controller("gantry", lambda gantry: gantry.set_input(1, level=not is_open))


async def door_is(fleet: VirtualFleet, is_open: bool) -> None:
    set_door(fleet, is_open)
    await fleet.wait_until(lambda states: states["gantry"].inputs["door"] == is_open)


# Motors and brakes


def test_a_brake_opens_after_the_motor_is_enabled_and_closes_before_it_is_disabled() -> None:
    brake = {"output": "brake", "release_s": 0.3, "engage_s": 0.2}
    fleet = changed(
        demo_fleet(),
        gantry={
            "outputs": {"lamp": {"number": 1, "safe": False}, "brake": {"number": 2}},
            "axes": {"x": {"brake": brake}},
        },
    )

    async def main(virtual: VirtualFleet) -> None:
        seen: list[tuple[str, int]] = []
        virtual.act_on_controller(
            "gantry",
            lambda gantry: gantry.on_output(
                lambda number, level: seen.append((f"output {number} {level}", virtual.clock.now_ns()))
            ),
        )
        began_ns = virtual.clock.now_ns()
        assert (await outcome(virtual, job("[{do: enable, axes: [gantry.x]}]"))).state == "done"
        enabled_ns = virtual.clock.now_ns()
        assert [what for what, _ in seen] == ["output 2 True"]
        assert enabled_ns - seen[0][1] >= 300_000_000
        assert seen[0][1] > began_ns
        assert (await virtual.make_client().status())["gantry"].axes["x"].enabled
        off = asyncio.get_running_loop().create_task(outcome(virtual, job("[{do: disable, axes: [gantry.x]}]")))
        await virtual.wait_until(lambda states: not states["gantry"].axes["x"].enabled)
        await off
        assert [what for what, _ in seen] == ["output 2 True", "output 2 False"]
        assert virtual.clock.now_ns() - seen[1][1] >= 200_000_000

    run_fleet(main, fleet)


def test_nothing_moves_before_the_brake_is_open() -> None:
    fleet = changed(demo_fleet(), gantry={"axes": {"x": {"brake": {"release_s": 2.0}}}})

    async def main(virtual: VirtualFleet) -> None:
        client = virtual.make_client()
        await client.submit(job("[{do: enable, axes: [gantry.x]}]"))
        await asyncio.sleep(0.5)
        states = await client.status()
        assert not states["gantry"].axes["x"].enabled
        report = await outcome(virtual, job("[{do: home, axes: [gantry.x]}]"))
        assert report.state == "done"  # it was queued after the enabling, and waited for the brake with it
        first = virtual.controllers["gantry"].commanded_motions[0]
        assert first.start_ns > 2_000_000_000

    run_fleet(main, fleet)


def test_state_of_the_motors_after_an_estop_and_after_a_stop() -> None:
    fleet = changed(demo_fleet(), gantry={"axes": {"x": {"on_estop": "disable"}}})

    async def main(virtual: VirtualFleet) -> None:
        client = virtual.make_client()
        await outcome(virtual, PREPARE)
        moving = await client.submit(job("[{do: move, to: {gantry.x: 390, gantry.y: 200}, speed: 0.2}]"))
        await virtual.wait_until(lambda states: states["gantry"].mode == "moving")
        await asyncio.sleep(0.7)
        await client.stop()
        await client.wait_for_job(moving)
        await client.start_queue()
        await asyncio.sleep(0.5)
        assert all(axis.enabled for axis in (await client.status())["gantry"].axes.values())
        again = await client.submit(job("[{do: move, to: {gantry.x: 390, gantry.y: 200}, speed: 0.2}]"))
        await virtual.wait_until(lambda states: states["gantry"].mode == "moving")
        await asyncio.sleep(0.7)
        await client.estop()
        await client.wait_for_job(again)
        states = await virtual.wait_until(lambda states: not states["gantry"].axes["x"].enabled)
        assert states["gantry"].axes["y"].enabled
        assert not virtual.controllers["gantry"].is_moving("X")

    run_fleet(main, fleet)


# Permits


def test_a_short_loss_of_a_permit_stops_the_step() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await door_is(fleet, False)
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        moving = await client.submit(TEN_S)
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        await asyncio.sleep(1.0)
        set_door(fleet, True)
        await asyncio.sleep(0.12)  # one poll at 10 Hz sees it
        set_door(fleet, False)
        report = await client.wait_for_job(moving)
        assert report.state == "failed"
        assert "permit" in report.reason
        await asyncio.sleep(1.0)
        assert not any(c.is_moving(a) for c in fleet.controllers.values() for a in c.axis_names)

    run_fleet(main, guarded())


def test_a_permit_must_have_settled() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await door_is(fleet, False)
        await asyncio.sleep(3.0)
        assert (await outcome(fleet, PREPARE)).state == "done"
        await door_is(fleet, True)
        await door_is(fleet, False)
        refused = await refusal(fleet, job("[{do: move, to: {gantry.x: 5}}]"))
        assert refused.code == "permit"
        assert "of 3 s): it has not settled yet" in refused.text
        await asyncio.sleep(3.0)
        assert (await outcome(fleet, job("[{do: move, to: {gantry.x: 5}}]"))).state == "done"

    run_fleet(main, guarded(DOOR.model_copy(update={"settle": 3_000_000_000, "axes": ["gantry.x"]})))


def test_a_permit_guards_homing_too() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, job("[{do: enable, axes: [gantry, stage]}]"))
        await door_is(fleet, True)
        refused = await refusal(fleet, job("[{do: home, axes: [gantry]}]"))
        assert (refused.code, fleet.controllers["gantry"].commanded_motions) == ("permit", [])
        await door_is(fleet, False)
        client = fleet.make_client()
        homing = await client.submit(job("[{do: home, axes: [gantry]}]"))
        await fleet.wait_until(lambda states: states["gantry"].mode == "homing")
        await asyncio.sleep(0.05)
        lost_ns = fleet.clock.now_ns()
        set_door(fleet, True)
        report = await client.wait_for_job(homing)
        assert report.state == "failed"
        assert "permit door-closed" in report.reason
        await asyncio.sleep(0.5)
        ends = [motion.end_ns for motion in fleet.controllers["gantry"].commanded_motions]
        assert all(end is not None and end < lost_ns + 400_000_000 for end in ends)
        assert not any(axis.referenced for axis in (await client.status())["gantry"].axes.values())

    run_fleet(main, guarded())


# Coordinates


def test_user_motor_and_raw_position_are_distinguished() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE, job("[{do: move, to: {gantry.x: 100}}]"))
        report = await outcome(fleet, job("[{do: set-position, axes: {gantry.x: '2 cm'}}]"))
        assert report.state == "done"
        now = (await fleet.make_client().status())["gantry"].axes["x"]
        assert (now.position, now.motor_position, now.raw_counts) == (20.0, 100.0, 100_000)
        assert now.offset == Fraction(-80)
        assert (await outcome(fleet, job("[{do: move, to: {gantry.x: 0}}]"))).state == "done"
        assert fleet.controllers["gantry"].position("X") == 80_000
        refused = await refusal(fleet, job("[{do: move, to: {gantry.x: 321}}]"))
        assert "target 321 mm is beyond its soft limits -90 to 320 mm" in refused.text
        # It is remembered over the adapter's death, and homing does not touch it.
        fleet.kill("host/local")
        await fleet.wait_until(lambda states: not states["gantry"].axes["x"].referenced)
        await fleet.wait_until(lambda states: all(s.mode == "idle" for s in states.values()))
        await outcome(fleet, PREPARE, job("[{do: move, to: {gantry.x: 0}}]"))
        assert fleet.controllers["gantry"].position("X") == 80_000
        await outcome(fleet, job("[{do: set-position, axes: {gantry.x: null}}]"))
        assert (await fleet.make_client().status())["gantry"].axes["x"].position == 80.0

    run_fleet(main)


@pytest.mark.parametrize(
    ("shortest", "target", "counts"),
    [(False, 350, 350_000), (True, 350, -10_000), (True, 190, -170_000), (False, 730, 10_000)],
)
def test_rotary_axes_wrap(shortest: bool, target: float, counts: int) -> None:
    turn = {
        "unit": "deg",
        "scale": 1000,
        "kind": "rotary",
        "wrap": 360,
        "shortest_way": shortest,
        "soft_limits": None,
        "limits": {"velocity": 200, "acceleration": 1000},
    }
    fleet = changed(demo_fleet(), gantry={"axes": {"x": turn}})

    async def main(virtual: VirtualFleet) -> None:
        report = await outcome(virtual, PREPARE, job(f"[{{do: move, to: {{gantry.x: {target}}}}}]"))
        assert report.state == "done", report.reason
        assert virtual.controllers["gantry"].position("X") == counts
        assert (await virtual.make_client().status())["gantry"].axes["x"].position == target % 360

    run_fleet(main, fleet)


def test_relative_moves_of_thirds_there_and_back_end_on_the_same_count() -> None:
    """The remainder is due with every third move."""
    fleet = changed(
        demo_fleet(), gantry={"axes": {"x": {"scale": "10000/3", "limits": {"velocity": 60, "acceleration": 9000}}}}
    )

    async def main(virtual: VirtualFleet) -> None:
        await outcome(virtual, PREPARE)
        before = virtual.controllers["gantry"].position("X")
        there, back = "{do: move, by: {gantry.x: 0.1}}", "{do: move, by: {gantry.x: -0.1}}"
        report = await outcome(virtual, job("[" + ", ".join([there] * 30 + [back] * 30) + "]"))
        assert report.state == "done", report.reason
        assert virtual.controllers["gantry"].position("X") == before
        furthest = max(abs(m.end_counts or 0) for m in virtual.controllers["gantry"].commanded_motions if m.axis == "X")
        assert round(furthest - before) == round(Fraction(3) * Fraction(10000, 3))

    run_fleet(main, fleet)


def test_relative_moves_of_thirds_in_jobs_of_their_own_add_up() -> None:
    """A move from rest begins at the exact target of the last one."""
    fleet = changed(demo_fleet(), gantry={"axes": {"x": {"scale": "10000/3"}}})

    async def main(virtual: VirtualFleet) -> None:
        await outcome(virtual, PREPARE)
        before = virtual.controllers["gantry"].position("X")
        for _ in range(3):
            report = await outcome(virtual, job("[{do: move, by: {gantry.x: 0.1}}]"))
            assert report.state == "done", report.reason
        assert virtual.controllers["gantry"].position("X") - before == 1000

    run_fleet(main, fleet)


# Configuration


def narrowed(fleet: Fleet, high: float) -> Fleet:
    return changed(fleet, gantry={"axes": {"x": {"soft_limits": {"min": -10, "max": high}}}})


def test_a_fleet_file_is_reloaded_by_idle_controllers_only() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE, job("[{do: move, to: {gantry.x: 200}}]"))
        assert await client.reload_fleet(demo_fleet()) == []
        moving = await client.submit(job("[{do: move, to: {stage.u: 40}, speed: 0.2}]"))
        await fleet.wait_until(lambda states: states["stage"].mode == "moving")
        with pytest.raises(Refusal, match="is in use by client"):
            await client.reload_fleet(narrowed(demo_fleet(), 100))
        assert (await client.wait_for_job(moving)).state == "done"
        before = await client.status()
        assert await client.reload_fleet(narrowed(demo_fleet(), 100)) == ["gantry"]
        after = await client.status()
        assert after["gantry"].digest != before["gantry"].digest
        assert after["stage"].instance == before["stage"].instance
        assert not after["gantry"].axes["x"].referenced  # it is another adapter, which has seen nothing yet
        # The axis stands at 200 mm, beyond the limit that is now at 100: home it, and the limit applies.
        assert (await outcome(fleet, PREPARE)).state == "done"
        assert (await refusal(fleet, job("[{do: move, to: {gantry.x: 150}}]"))).code == "soft-limit"
        assert (await outcome(fleet, job("[{do: move, to: {gantry.x: 100}}]"))).state == "done"
        # A host that is restarted begins with the loaded configuration.
        fleet.kill("host/local")
        await fleet.wait_until(lambda states: states["gantry"].instance != after["gantry"].instance)
        states = await fleet.wait_until(lambda states: all(s.mode == "idle" for s in states.values()))
        assert states["gantry"].digest == after["gantry"].digest

    run_fleet(main)


def test_a_reload_cannot_change_everything() -> None:
    base = demo_fleet()
    elsewhere = changed(base, gantry={"link": {"kind": "tcp", "host": "192.168.1.99", "port": 23}})
    fewer = base.model_copy(
        update={"controllers": {"gantry": base.controllers["gantry"]}, "groups": {}, "home_order": []}
    )
    wrong = changed(base, gantry={"axes": {"x": {"motors": ["Q"]}}}, stage={"options": {"nm_per_pulse": 50}})

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        for file, words in (
            (elsewhere, r"controllers\.gantry\.link would change"),
            (fewer, "controller stage would be added or removed"),
            (wrong, "there is no motor 'Q'"),
            (base.model_copy(update={"fleet": "other"}), "the file is of fleet other, but the running fleet is demo"),
        ):
            with pytest.raises(Refusal, match=words):
                await client.reload_fleet(file)
        # One that refuses keeps all others from changing.
        assert {name: state.digest for name, state in (await client.status()).items()} == {
            name: config.digest for name, config in base.controllers.items()
        }

    run_fleet(main)


# The e-stop's reset


def test_a_reset_needs_the_conditions_of_every_latched_adapter() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await client.estop("a hand in the machine")
        fleet.wires["stage"].cut = True
        await fleet.wait_until(lambda states: states["stage"].mode == "offline")
        answers = await client.reset()
        assert answers["gantry"] is None
        stage = answers["stage"]
        assert stage is not None
        assert stage.code == "offline"
        assert all(state.estop is not None for state in (await client.status()).values())
        fleet.wires["stage"].cut = False
        await fleet.wait_until(lambda states: states["stage"].mode == "idle")
        other = await client.reset("no-such-event")
        assert [refused.code for refused in other.values() if refused] == ["other-estop", "other-estop"]
        states = await client.status()
        latch = states["gantry"].estop
        assert latch is not None
        assert await client.reset(latch.event) == {"gantry": None, "stage": None}
        assert all(state.estop is None for state in (await client.status()).values())

    run_fleet(main)


# Power cycles


def reference_lost(states: dict[str, ControllerState], name: str) -> bool:
    return not any(axis.referenced for axis in states[name].axes.values())


@pytest.mark.parametrize("name", ["gantry", "stage"])
def test_a_power_cycle_while_idle_clears_the_reference(name: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        fleet.act_on_controller(name, lambda unit: unit.set_power(on=False))
        await asyncio.sleep(1.0)
        fleet.act_on_controller(name, lambda unit: unit.set_power(on=True))
        states = await fleet.wait_until(lambda states: states[name].mode == "idle" and reference_lost(states, name))
        other = "stage" if name == "gantry" else "gantry"
        assert all(axis.referenced for axis in states[other].axes.values())
        axis = "x" if name == "gantry" else "u"
        move = job(f"[{{do: enable, axes: [{name}]}}, {{do: move, to: {{{name}.{axis}: 1}}}}]")
        assert (await refusal(fleet, move)).code == "not-referenced"

    run_fleet(main)


@pytest.mark.parametrize("name", ["gantry", "stage"])
@pytest.mark.parametrize("state", ["armed", "moving"])
def test_a_power_cycle_of_an_armed_or_moving_controller_stops_the_step(name: str, state: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        await outcome(fleet, PREPARE)
        before = {each: len(controller.commanded_motions) for each, controller in fleet.controllers.items()}
        moving = await client.submit(TEN_S)
        async with asyncio.timeout(10.0):
            while (await client.status())[name].mode != state:
                await asyncio.sleep(0.002)
        if state == "moving":
            await asyncio.sleep(1.0)
        fault_ns = fleet.clock.now_ns()
        fleet.act_on_controller(name, lambda unit: unit.set_power(on=False))
        await asyncio.sleep(0.3)
        fleet.act_on_controller(name, lambda unit: unit.set_power(on=True))
        report = await client.wait_for_job(moving)
        assert report.state == "failed"
        await asyncio.sleep(2.0)
        for each, controller in fleet.controllers.items():
            for motion in controller.commanded_motions[before[each] :]:
                assert motion.end_ns is not None
                assert motion.end_ns - fault_ns < 1_500_000_000
        await fleet.wait_until(lambda states: states[name].mode == "idle" and reference_lost(states, name))
        assert (await outcome(fleet, PREPARE, TEN_S)).state == "done"

    run_fleet(main)


# Following and settling


@pytest.mark.parametrize("native", [True, False])
def test_an_axis_that_does_not_follow_stops_its_step(native: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    """With the controller's own supervision (ER, which switches the motor off), and by the adapter's polls alone."""

    async def find_nothing(*_: object, **__: object) -> tuple[()]:
        return ()

    # A changed ER would be found, and no step begun.
    monkeypatch.setattr(SMC4000Driver, "check_settings", find_nothing)
    fleet = changed(demo_fleet(), gantry={"axes": {"x": {"following_error": 1.5}}})

    async def main(virtual: VirtualFleet) -> None:
        await outcome(virtual, PREPARE)
        client = virtual.make_client()
        if not native:
            await client.send_raw("gantry", "ER 32767;OE 0", i_know=True)
        moving = await client.submit(TEN_S)
        await virtual.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        await asyncio.sleep(1.0)
        virtual.act_on_controller("gantry", lambda gantry: gantry.set_stalled("X", stalled=True))
        stalled_ns = virtual.clock.now_ns()
        report = await client.wait_for_job(moving)
        assert report.state == "failed"
        assert "axis x" in report.reason
        await asyncio.sleep(1.0)
        ends = [m.end_ns for each in virtual.controllers.values() for m in each.commanded_motions[-1:]]
        assert all(end is not None and end - stalled_ns < 600_000_000 for end in ends)
        if not native:
            fault = (await client.status())["gantry"].faults[0]
            assert (fault.code, fault.axis) == ("following-error", "x")
            assert "1.5 are allowed" in fault.text
            virtual.act_on_controller("gantry", lambda gantry: gantry.set_stalled("X", stalled=False))
            again = job("[{do: disable, axes: [gantry]}, {do: enable, axes: [gantry]}, {do: move, to: {gantry.x: 9}}]")
            assert (await outcome(virtual, again)).state == "done"

    run_fleet(main, fleet)


def test_an_axis_has_arrived_only_after_it_has_settled() -> None:
    window = {"done": "in_position", "in_position_window": 0.01, "in_position_timeout_s": 6}
    fleet = changed(demo_fleet(), gantry={"axes": {"x": window}})

    async def main(virtual: VirtualFleet) -> None:
        client = virtual.make_client()
        report = await outcome(virtual, PREPARE, job("[{do: move, to: {gantry.x: 5, gantry.y: 5}}]"))
        assert report.state == "done"
        evidence = report.steps[-1].members["gantry"].evidence
        assert evidence["x"].settled_s is not None
        assert evidence["x"].settled_s < 0.1
        assert evidence["y"].settled_s is None
        moving = await client.submit(job("[{do: move, to: {gantry.x: 6}}]"))
        await virtual.wait_until(lambda states: states["gantry"].mode == "moving")
        virtual.act_on_controller("gantry", lambda gantry: gantry.set_stalled("X", stalled=True))
        report = await client.wait_for_job(moving)
        assert report.state == "failed"
        assert "off its target after 6" in report.reason
        assert "its window is 0.01" in report.reason

    run_fleet(main, fleet)


def test_an_estop_is_written_to_all_controllers_before_anything_waits_for_a_disk(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    order: list[str] = []
    write, save = MemoryLink.write, FileStore.save

    def told(link: MemoryLink, data: bytes) -> int:
        order.append(data.decode("latin-1"))
        return write(link, data)

    def kept(store: FileStore, memory: AdapterMemory) -> None:
        order.append("disk")
        save(store, memory)

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        moving = await client.submit(TEN_S)
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        monkeypatch.setattr(MemoryLink, "write", told)
        monkeypatch.setattr(FileStore, "save", kept)
        await client.estop("a test")
        await moving.result()
        assert {"AB\r", "L:E\r\n"} < set(order[: order.index("disk")])
        assert order.count("disk") == 2

    run_fleet(main)


def test_a_client_that_waits_for_a_job_whose_record_is_damaged_gets_a_report() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        waiting = await client.submit(PREPARE, terms=QueueTerms(held=True))
        ending = asyncio.ensure_future(client.wait_for_job(waiting))
        await asyncio.sleep(1.5)
        fleet.journal.database.write("UPDATE jobs SET state = 'quEued'")
        fleet.kill("coordinator/first")
        fleet.start_coordinator("second")
        async with asyncio.timeout(10.0):
            report = await ending
        assert report.state == "failed" and "its record in the journal is damaged: the state 'quEued'" in report.reason
        assert (await client.show_job(waiting)).entry is not None

    run_fleet(main)


def test_a_full_disk_of_a_host_refuses_what_must_be_stored_and_nothing_else() -> None:
    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        fleet.host_disks["local"].full = True
        await client.estop("a test")
        states = await fleet.wait_until(lambda states: all(each.estop is not None for each in states.values()))
        refused = (await client.reset())["gantry"]
        assert refused is not None and "the memory of gantry cannot be saved" in refused.text
        states = await client.status()
        assert states["gantry"].estop is not None and not states["gantry"].faults
        fleet.kill("coordinator/first")
        fleet.start_coordinator("second")
        await asyncio.sleep(2.0)  # it cannot be adopted: its epoch would be forgotten
        states = await client.status()
        assert states["gantry"].epoch == 2 and states["gantry"].mode != "offline"
        fleet.host_disks["local"].full = False
        await client.reset()
        assert (await outcome(fleet, PREPARE)).state == "done"

    run_fleet(main)


def test_a_slow_disk_does_not_delay_an_estop() -> None:
    takes_s = 2.0

    async def main(fleet: VirtualFleet) -> None:
        await outcome(fleet, PREPARE)
        client = fleet.make_client()
        moving = await client.submit(TEN_S)
        await fleet.wait_until(lambda states: all(state.mode == "moving" for state in states.values()))
        fleet.host_disks["local"].draw_delay_ns = lambda: round(takes_s * NS_PER_S)
        began_ns = fleet.clock.now_ns()
        await client.estop("a test")
        await moving.result()
        await fleet.wait_until(lambda states: all(each.estop is not None for each in states.values()))
        # The stage's motors go off at an e-stop, when they rest.
        await fleet.wait_until(lambda states: not states["stage"].axes["u"].enabled)
        assert fleet.clock.now_ns() - began_ns < NS_PER_S
        await asyncio.sleep(2 * takes_s)
        fleet.kill("host/local")
        states = await fleet.wait_until(lambda states: all(each.mode in ("idle", "fault") for each in states.values()))
        assert all(each.estop is not None and each.estop.reason == "a test" for each in states.values())

    run_fleet(main)
