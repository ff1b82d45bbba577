"""The SHRC-203 driver against the simulated controller over a serial line, judged by the simulator's ground truth."""

import asyncio
from collections.abc import Awaitable, Callable, Mapping
from contextvars import copy_context
from dataclasses import dataclass
from random import Random
from typing import Any

import pytest
from unit.adapters.restarts import sees_the_restart

from adapters.contract import DriverSetup
from adapters.shrc203 import MAKE
from adapters.shrc203.driver import ShrcDriver
from adapters.shrc203.wire.status import DISCONNECTED, SCALE_ERROR, is_position_lost
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import MemoryWire, serial_wire
from orchestrator.model.errors import ControllerFault, Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.plan.step import AxisMove, plan_step
from sim.core.controller import CommandedMotion, FirmwareTiming, SimulatedController
from sim.core.oscillator import Oscillator
from sim.shrc203 import SHRC203

TIMING = FirmwareTiming(decode_ns=1_000_000, spread_ns=1_000_000)
NAMES = {"x": "1", "y": "2", "z": "3"}


def controller(names: str = "xyz", **more: Any) -> Controller:
    axes = {
        name: {
            "motors": [NAMES[name]],
            "unit": "mm",
            "scale": 1_000_000,
            "limits": {"velocity": 0.1, "acceleration": 0.5},
            "homing": {"method": "orgs", "speed": 0.01},
        }
        for name in names
    }
    return Controller.model_validate(
        {"adapter": "shrc203", "link": {"kind": "serial", "device": "/dev/ttyUSB0"}, "axes": axes, **more}
    )


@dataclass
class Bench:
    clock: VirtualClock
    unit: SimulatedController
    wire: MemoryWire
    driver: ShrcDriver
    config: Controller

    async def ready(self) -> None:
        await self.driver.connect()
        await self.driver.configure()
        await self.driver.poll()

    async def arm(self, targets: Mapping[str, int], lead_ns: int = 400 * NS_PER_MS) -> int:
        """Plan from the present positions, arm, and return T0."""
        reading = await self.driver.poll()
        moves = [
            AxisMove(name, reading.axes[name].commanded_counts, target, 100_000.0, 500_000.0)
            for name, target in targets.items()
        ]
        lowered = self.driver.lower_profiles(plan_step(moves).profiles, StartOptions(), None)
        t0_ns = self.clock.now_ns() + lead_ns
        await self.driver.slots.present.load(lowered, t0_ns, None)
        return t0_ns

    async def start(self, targets: Mapping[str, int]) -> int:
        t0_ns = await self.arm(targets)
        await self.driver.slots.present.verify()
        await self.driver.slots.present.release()
        return t0_ns

    def moved(self) -> list[CommandedMotion]:
        return [
            each for each in self.unit.commanded_motions if each.end_counts != each.start_counts or each.end_ns is None
        ]


Case = Callable[[Bench], Awaitable[None]]


def run(
    case: Case,
    *,
    seed: int = 0,
    config: Controller | None = None,
    options: Mapping[str, Any] | None = None,
    simulate: Mapping[str, Any] | None = None,
    ppm: float = 0.0,
    timing: FirmwareTiming = TIMING,
    hold_ns: int = 0,
) -> None:
    async def main(clock: VirtualClock) -> None:
        fleet = config or controller()
        unit = SHRC203.build_controller(
            clock, simulate or {}, oscillator=Oscillator(drift_ppm=ppm, seed=seed), timing=timing, seed=seed
        )
        wire = MemoryWire(
            clock, serial_wire(38400, hold_ns=hold_ns), unit, unit.port_names[0], "serial a", copy_context(), seed
        )
        setup = DriverSetup(
            "a", fleet, MAKE.options_model.model_validate(options or {}), clock, wire.open_link, LoopTimedWriter(clock)
        )
        driver = MAKE.create_driver(setup)
        assert isinstance(driver, ShrcDriver)
        await case(Bench(clock, unit, wire, driver, fleet))
        await driver.close()

    run_virtual(main)


def test_a_fresh_controller_is_connected_and_read() -> None:
    async def case(bench: Bench) -> None:
        identity = await bench.driver.connect()
        assert (identity.model, identity.firmware, identity.serial) == ("SHRC-203", "V2.00.000", "2106001001")
        await bench.driver.configure()
        reading = await bench.driver.poll()
        assert {name: axis.commanded_counts for name, axis in reading.axes.items()} == {"x": 0, "y": 0, "z": 0}
        assert all(axis.enabled and not axis.moving and axis.limit == "none" for axis in reading.axes.values())
        assert not reading.faults and not reading.restarted

    run(case)


@pytest.mark.parametrize("seed", range(12))
def test_starts_and_ends_are_within_the_reported_intervals(seed: int) -> None:
    async def case(bench: Bench) -> None:
        draw = Random(seed)
        await bench.ready()
        for _ in range(3):
            targets = {name: draw.randrange(-60_000, 60_000) for name in draw.sample("xyz", draw.randint(1, 3))}
            seen = len(bench.unit.commanded_motions)
            t0_ns = await bench.start(targets)
            started = await bench.driver.slots.present.wait_for_start()
            if draw.random() < 0.5:
                await bench.driver.poll()
            outcome = await bench.driver.slots.present.wait_for_end()
            assert outcome.state == "done", outcome
            truth = {each.axis: each for each in bench.unit.commanded_motions[seen:]}
            assert set(truth) == {NAMES[name] for name in targets}
            for name, target in targets.items():
                motion = truth[NAMES[name]]
                assert motion.end_counts == target
                assert started[name].earliest_ns <= motion.start_ns <= started[name].latest_ns
                assert motion.end_ns is not None
                assert outcome.ended[name].earliest_ns <= motion.end_ns <= outcome.ended[name].latest_ns
                assert abs(motion.start_ns - t0_ns) < 2.3 * NS_PER_MS

    run(case, seed=seed, ppm=Random(seed).uniform(-95, 95), hold_ns=seed % 2 * 16 * NS_PER_MS)


def test_the_answer_to_a_poll_is_not_taken_for_the_completion_of_a_move_that_is_released_meanwhile() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.unit.set_input(1, level=True)  # its inputs are answered by the digit that motor 1 ends with
        for number, after_ms in enumerate(range(2, 44, 3)):
            await bench.arm({"x": 0 if number % 2 else 400})
            poll = asyncio.ensure_future(bench.driver.poll())
            await sleep_ns(bench.clock, after_ms * NS_PER_MS)
            await bench.driver.slots.present.release()
            assert (await poll).inputs[1]
            started = await bench.driver.slots.present.wait_for_start()
            assert started["x"].earliest_ns <= bench.unit.commanded_motions[-1].start_ns <= started["x"].latest_ns
            assert (await bench.driver.slots.present.wait_for_end()).state == "done"
            assert len(bench.moved()) == number + 1

    run(case, config=controller(inputs={"start": {"number": 1}}))


def test_a_disarmed_move_never_runs() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.arm({"x": 5000, "z": -4000})
        await bench.driver.slots.unload()
        await bench.driver.slots.unload()
        await bench.driver.send_raw("G")  # regardless of what others do now
        await sleep_ns(bench.clock, NS_PER_S)
        assert not bench.moved()

    run(case)


@pytest.mark.parametrize("before_ms", [390, 200, 50, 5, 2])
def test_a_cancelled_fire_never_moves(before_ms: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        t0_ns = await bench.start({"x": 5000, "y": 100})
        await sleep_ns(bench.clock, max(0, t0_ns - before_ms * NS_PER_MS - bench.clock.now_ns()))
        if bench.clock.now_ns() > t0_ns - 3 * NS_PER_MS:
            return  # the starting line is on the wire
        await bench.driver.slots.unload()
        await sleep_ns(bench.clock, NS_PER_S)
        assert not bench.moved()
        await bench.start({"x": 3000})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case)


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize(
    "simulate",
    [
        {},
        {"stop_keeps_prebuffer": True},
        {"completion_after_stop": False},
        {"emergency_excitation_off": False},
        {"repeat_executed": True},
        {"standby_needs_running": True},
    ],
)
def test_a_stop_ends_the_move_and_leaves_nothing_queued(abort: bool, simulate: dict[str, Any]) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 80_000, "y": -70_000})
        await bench.driver.slots.present.wait_for_start()
        await sleep_ns(bench.clock, 300 * NS_PER_MS)
        await bench.driver.stop(abort=abort)
        outcome = await bench.driver.slots.present.wait_for_end()
        assert outcome.state == ("fault" if abort else "stopped"), outcome
        for motion in bench.unit.commanded_motions:
            name = "x" if motion.axis == "1" else "y"
            assert motion.end_ns is not None
            assert outcome.ended[name].earliest_ns <= motion.end_ns <= outcome.ended[name].latest_ns
        await bench.driver.clear_faults()
        await bench.driver.set_enabled(["x", "y", "z"], on=True)
        count = len(bench.unit.commanded_motions)
        await bench.driver.send_raw("G:W")
        await sleep_ns(bench.clock, NS_PER_S)
        if "repeat_executed" not in simulate:  # there the controller itself repeats its executed moves
            assert not [each for each in bench.unit.commanded_motions[count:] if each.end_counts != each.start_counts]
        await bench.start({"x": 0})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case, simulate=simulate)


def test_homing_finds_the_origin() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.home_axes(["x", "z"], lambda _: None)
        reading = await bench.driver.poll()
        assert reading.axes["x"].commanded_counts == reading.axes["z"].commanded_counts == 0
        assert not any(axis.moving for axis in reading.axes.values())
        assert bench.moved()

    run(case)


def test_a_limit_in_motion_is_a_fault() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 80_000, "y": 10_000})
        await bench.driver.slots.present.wait_for_start()
        await sleep_ns(bench.clock, 300 * NS_PER_MS)
        bench.unit.set_limit("1", "forward")
        outcome = await bench.driver.slots.present.wait_for_end()
        assert outcome.state == "fault" and "limit" in outcome.reason
        reading = await bench.driver.poll()
        assert reading.axes["x"].limit == "forward" and reading.axes["y"].limit == "none"

    run(case)


@pytest.mark.parametrize("when", ["idle", "armed", "moving"])
def test_a_power_cycle_is_noticed(when: str) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        if when == "armed":
            await bench.arm({"x": 5000})
        elif when == "moving":
            await bench.start({"x": 80_000})
            await bench.driver.slots.present.wait_for_start()
            await sleep_ns(bench.clock, 200 * NS_PER_MS)
        bench.unit.set_power(on=False)
        await sleep_ns(bench.clock, 50 * NS_PER_MS)
        bench.unit.set_power(on=True)
        await sleep_ns(bench.clock, 100 * NS_PER_MS)
        if not bench.wire.links:
            await bench.driver.close()
            await bench.ready()
            return
        if when == "armed":
            with pytest.raises(Refusal):
                await bench.driver.slots.present.verify()
        await sees_the_restart(bench.driver)
        await bench.start({"x": 1000})
        await bench.driver.slots.present.wait_for_start()
        assert (await bench.driver.slots.present.wait_for_end()).state == "done"

    run(case)


@pytest.mark.parametrize("nth", range(1, 14))
def test_a_refusal_while_arming_leaves_nothing_armed(nth: int) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.driver.poll()
        left = nth

        def refuse(data: bytes) -> bytes:
            nonlocal left
            left -= 1
            return b"NG\r\n" if left in (0, -1) else data

        bench.wire.to_near = refuse
        try:
            await bench.arm({"x": 5000, "y": 7000})
        except (Refusal, ControllerFault) as error:
            assert "NG" in str(error) or "load" in str(error) or "understood" in str(error)
        bench.wire.to_near = None
        await bench.driver.slots.unload()
        await bench.driver.send_raw("G")
        await sleep_ns(bench.clock, NS_PER_S)
        assert not bench.moved()

    run(case)


def test_silence_is_named() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.wire.cut = True
        with pytest.raises(ControllerFault, match="no reply") as caught:
            await bench.driver.poll()
        assert caught.value.code == "no-answer"
        bench.wire.cut = False
        await bench.driver.poll()

    run(case)


def test_garbage_is_named_and_one_garbled_line_survived() -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        bench.wire.to_near = lambda data: b"\xf3" + data[1:]
        with pytest.raises(ControllerFault) as caught:
            await bench.driver.send_raw("Q:")
            await bench.driver.poll()
        assert caught.value.code in ("garbage", "no-answer")
        garbled = 0

        def once(data: bytes) -> bytes:
            nonlocal garbled
            garbled += 1
            return b"#?" + data[2:] if garbled == 2 else data

        bench.wire.to_near = None
        await bench.driver.poll()
        bench.wire.to_near = once
        await bench.driver.poll()

    run(case)


@pytest.mark.parametrize("lose", [b"OK\r\n", b"1\r\n"])
def test_a_lost_answer_or_completion_does_not_lose_the_move(lose: bytes) -> None:
    async def case(bench: Bench) -> None:
        await bench.ready()
        await bench.start({"x": 60_000})
        bench.wire.to_near = lambda data: b"" if data == lose else data
        started = await bench.driver.slots.present.wait_for_start()
        outcome = await bench.driver.slots.present.wait_for_end()
        bench.wire.to_near = None
        assert outcome.state == "done"
        (motion,) = bench.unit.commanded_motions
        assert motion.end_ns is not None
        assert started["x"].earliest_ns <= motion.start_ns <= started["x"].latest_ns
        assert outcome.ended["x"].earliest_ns <= motion.end_ns <= outcome.ended["x"].latest_ns

    run(case)


@pytest.mark.parametrize(
    ("word", "excited", "closed_loop", "lost"),
    [
        (0, True, False, False),
        (0, False, False, True),
        (0, False, True, False),
        (SCALE_ERROR, True, True, True),
        (SCALE_ERROR, True, False, False),
        (DISCONNECTED, True, False, True),
        (DISCONNECTED, True, True, True),
    ],
)
def test_a_position_is_lost_without_torque_in_open_loop_and_without_scale_in_closed_loop(
    word: int, excited: bool, closed_loop: bool, lost: bool
) -> None:
    assert is_position_lost(word, excited=excited, closed_loop=closed_loop) is lost
