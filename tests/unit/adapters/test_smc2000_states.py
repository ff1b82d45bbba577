"""Conditions on the SMC-2000's line and in the controller itself, and how the driver handles them."""

from random import Random
from typing import Any, cast

import pytest
from unit.adapters.test_smc2000_bench import FLEET, LIMITS, World, run, trapezoid, typed
from unit.random_rounds import share_with_nightly

from adapters.yaskawa.smc2000.driver import MAKE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller


@pytest.mark.parametrize(
    "before",
    [
        "",
        "BGX",
        "PR 5000;BGX",
        'MG "half',
        "EO 0\r",
        "CW 1\r",
        "%3\r",
        "%3",
        "PF -8.0\rVF -4.2\rLZ 0\r",
        "MO\r",
        "DL\r#MINE;PR 10",
        "bg\rXYZZY\r",
        "\x12",
        "X" * 200,
    ],
    ids=repr,
)
def test_it_is_connected_in_any_state_and_nothing_moves(before: str):
    async def main(world: World) -> None:
        link = await world.wire.open_link()
        await typed(world.clock, link, before)
        await link.close()
        await sleep_ns(world.clock, NS_PER_MS)
        await world.ready(5)
        assert not world.controller.commanded_motions
        _, _, outcome, _ = await world.moved({"x": trapezoid(0, 5000, 20_000, 200_000)})
        assert outcome.state == "done", outcome

    run(main)


@pytest.mark.parametrize(
    "options",
    [
        {"axes": 2},
        {"axes": 8},
        {"question_crlf": True},
        {"sign_column": False},
        {"st_halts_programs": False},
        {"motors_on": False},
        {"echo": False},
        {"firmware": "D150N19p"},
        {"command_s": 0.0002},
        {"control_end": "separate"},
        {"control_end": "required"},
        {"upload_line_end": True},
    ],
    ids=repr,
)
def test_every_open_point_of_the_manual_is_supported(options: dict[str, Any]):
    async def main(world: World) -> None:
        await world.ready()
        profiles = {"x": trapezoid(0, 5000, 20_000, 200_000), "y": trapezoid(0, -3000, 20_000, 200_000)}
        _, _, outcome, _ = await world.moved(profiles)
        assert outcome.state == "done"
        assert (world.controller.position("X"), world.controller.position("Y")) == (5000, -3000)
        assert "Unrecognized" in await world.driver.send_raw("tpx")
        assert (await world.driver.send_raw("MG _RPX")).strip() == "5000"

    run(main, options=options)


def test_a_motion_started_by_others_continues():
    async def main(world: World) -> None:
        await world.talk("SH;PR 100000;SP 10000;BGX")
        await world.driver.connect()
        await world.driver.configure()
        assert (await world.driver.poll()).axes["x"].moving
        await sleep_ns(world.clock, 12 * NS_PER_S)
        assert world.controller.position("X") == 100_000

    run(main)


def test_another_program_is_not_destroyed_while_it_runs():
    async def main(world: World) -> None:
        await world.talk("DL\r#LOOP;WT 10;JP #LOOP\r\x1a")
        await world.talk("XQ #LOOP,3")
        with pytest.raises(ControllerFault, match="thread 3") as fault:
            await world.driver.connect()
        assert fault.value.code == "other-program"
        await world.driver.close()
        await sleep_ns(world.clock, NS_PER_MS)
        await world.talk("HX3")
        await world.driver.connect()
        await world.driver.poll()

    run(main)


def test_a_blocked_interpreter_is_a_fault_with_a_remedy():
    async def main(world: World) -> None:
        await world.ready(3)
        for _ in range(3):
            began_ns = world.clock.now_ns()
            with pytest.raises(ControllerFault, match="came after") as fault:
                await world.driver.send_raw("WT 10000")
            assert fault.value.code == "no-answer" and "interpreter" in fault.value.remedy
            assert world.clock.now_ns() - began_ns < NS_PER_S
        await sleep_ns(world.clock, 30 * NS_PER_S)
        assert not (await world.driver.poll()).restarted

    run(main)


@pytest.mark.parametrize("noise", [b"\xff\xfe\x80\r\n", b"GARBAGE\r\n:", b"?", b"\x00" * 100])
def test_noise_is_a_fault_and_the_next_poll_succeeds(noise: bytes):
    async def main(world: World) -> None:
        await world.ready(5)
        world.wire.to_near = lambda data: noise
        with pytest.raises((ControllerFault, LinkClosed)):
            await world.driver.poll()
        world.wire.to_near = None
        assert not (await world.driver.poll()).restarted
        assert float(await world.driver.send_raw("MG 123")) == 123

    run(main)


def test_bytes_without_end_are_a_fault_within_a_second():
    """Nothing is silent then: only their number shows that they are no reply, and the state must not stay as it was."""

    async def main(world: World) -> None:
        await world.ready(5)
        world.wire.to_near = lambda data: data * 400
        await world.driver.send_raw("MG 123")  # a flood of six seconds
        began_ns = world.clock.now_ns()
        with pytest.raises(ControllerFault, match="at most"):
            await world.driver.poll()
        assert world.clock.now_ns() - began_ns < NS_PER_S
        world.wire.to_near = None
        await world.driver.close()
        await world.driver.connect()
        began_ns = world.clock.now_ns()
        assert not (await world.driver.poll()).restarted
        assert world.clock.now_ns() - began_ns < NS_PER_S // 10

    run(main)


@pytest.mark.parametrize("seed", share_with_nightly(range(12), 4))
def test_lost_and_garbled_bytes_never_become_wrong_values(seed: int):
    async def main(world: World) -> None:
        await world.ready(5)
        draw = Random(seed)

        def spoilt(data: bytes) -> bytes:
            return bytes(byte for byte in data if draw.random() > 0.01)

        world.wire.to_near = spoilt
        good = 0
        for _ in range(150):
            try:
                reading = await world.driver.poll()
            except (ControllerFault, LinkClosed):
                continue
            good += 1
            assert reading.axes["x"].commanded_counts == 0 and reading.axes["x"].enabled
        assert good > 60

    run(main, seed=seed)


def test_a_power_cycle_and_a_reset_are_distinguished_from_a_broken_cable():
    async def main(world: World) -> None:
        await world.ready(5)
        for what in ("cut", "power", "reset"):
            if what == "cut":
                world.wire.cut = True
            elif what == "power":
                world.controller.set_power(on=False)
                await sleep_ns(world.clock, 5 * NS_PER_S)
                world.controller.set_power(on=True)
            else:
                await world.driver.send_raw("RS")
            with pytest.raises((LinkClosed, LinkRefused, ControllerFault)):
                for _ in range(3):
                    await world.driver.poll()
            world.wire.cut = False
            await world.driver.close()
            await sleep_ns(world.clock, 2 * NS_PER_S)
            await world.driver.connect()
            await world.driver.configure()
            assert (await world.driver.poll()).restarted is (what != "cut"), what
            assert not (await world.driver.poll()).restarted

    run(main)


def test_switches_are_reported_in_words_and_a_limit_ends_a_move():
    async def main(world: World) -> None:
        await world.ready(5)
        world.controller.set_limit("Y", "reverse")
        assert (await world.driver.poll()).axes["y"].limit == "reverse"
        world.controller.set_limit("Y", "none")
        await world.driver.load_soft_limits({"x": (-4000, 9000)})
        _, _, outcome, _ = await world.moved({"x": trapezoid(0, 50_000, 20_000, 200_000)})
        assert outcome.state == "fault" and "forward limit" in outcome.reason

    run(main)


@pytest.mark.parametrize("method", ["default", "edge", "index"])
def test_it_is_homed_by_every_documented_method(method: str):
    homing = {"method": method, "speed": 5.0, "direction": "positive"}
    axes = {"x": {"motors": ["A"], "unit": "mm", "scale": 1000, "limits": LIMITS, "homing": homing}}

    async def main(world: World) -> None:
        await world.driver.connect()
        await world.driver.configure()
        await world.driver.set_enabled(["x"], on=True)
        found: list[str] = []
        assert await world.driver.home_axes(["x"], found.append) == {}
        assert found == ["x"]
        assert world.controller.position("X") == 0

    run(main, fleet=FLEET | {"axes": axes}, options={"home_edge": {"X": 3000}, "index_every": {"X": 500}})


def test_refused_commands_report_the_reason():
    async def main(world: World) -> None:
        await world.ready(3)
        world.controller.set_limit("X", "both")
        await world.driver.poll()
        with pytest.raises(Refusal, match="22 Begin not possible due to Limit Switch"):
            await cast(Any, world.driver)._device.session.send_command("PRX=100")
            await cast(Any, world.driver)._device.session.send_command("BGX")
        for line in ("DL", "%1", "!BG", "QD A[],0,1"):
            with pytest.raises(Refusal, match="not answered by a single line"):
                await world.driver.send_raw(line)

    run(main)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"link": {"kind": "tcp", "host": "h", "port": 23}}, "link.kind"),
        ({"link": FLEET["link"] | {"address": 8}}, "link.address"),
        ({"link": FLEET["link"] | {"parity": "even"}}, "parity"),
        ({"axes": {"x": FLEET["axes"]["x"] | {"motors": ["Q"]}}}, "no motor"),
        (
            {"axes": {"x": FLEET["axes"]["x"] | {"limits": {"velocity": 9000, "acceleration": 9}}}},
            "the maximum is 8000",
        ),
        ({"inputs": {"i": {"number": 25}}}, "inputs 1 to 24"),
        ({"options": {"motor_type": {"z": 2}}}, "no axis z"),
    ],
)
def test_the_fleet_file_is_checked_offline(change: dict[str, Any], words: str):
    with pytest.raises(ValueError, match=words):
        MAKE.check_config(Controller.model_validate(FLEET | change))


def test_a_stepper_that_is_off_has_lost_its_position():
    async def main(world: World) -> None:
        link = await world.wire.open_link()
        await typed(world.clock, link, "MTX=2\r")
        await link.close()
        await world.ready()
        assert not any(axis.position_lost for axis in (await world.driver.poll()).axes.values())
        await world.driver.set_enabled(["x", "y"], on=False)
        axes = (await world.driver.poll()).axes
        assert axes["x"].position_lost and not axes["y"].position_lost
        await world.driver.set_enabled(["x"], on=True)
        assert not (await world.driver.poll()).axes["x"].position_lost

    run(main, fleet=FLEET | {"options": {"motor_type": {"x": 2}}})
