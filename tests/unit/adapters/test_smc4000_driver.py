"""The SMC-4000's driver against the simulated controller, in virtual time; verdicts by the simulator's truth."""

from collections.abc import Callable, Coroutine
from contextvars import copy_context
from dataclasses import dataclass
from random import Random
from typing import Any

import pytest

from adapters.contract import CannotDo, Driver, DriverFault, Setup
from adapters.firing import LoopFirer
from adapters.yaskawa.options import Options
from adapters.yaskawa.smc4000 import MAKE
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns, sleep_until_ns
from orchestrator.clock.virtual import run_virtual
from orchestrator.link.base import LinkClosed, LinkRefused
from orchestrator.link.memory import LAN, MemoryWire
from orchestrator.model.fleet import Controller
from orchestrator.model.profile import Profile
from sim.core.controller import SimulatedController, Timing
from sim.core.oscillator import Oscillator
from sim.yaskawa import SMC4000

LIMITS = {"velocity": 100.0, "acceleration": 1000.0}
FLEET = {
    "adapter": "smc4000",
    "link": {"kind": "tcp", "host": "10.0.0.1", "port": 23},
    "axes": {
        "x": {"motors": ["X"], "unit": "mm", "scale": 1000, "limits": LIMITS},
        "y": {"motors": ["Y"], "unit": "mm", "scale": 1000, "limits": LIMITS},
    },
}


@dataclass
class World:
    clock: Clock
    controller: SimulatedController
    wire: MemoryWire
    driver: Driver
    other: Callable[[], Any]

    async def talk(self, line: str) -> str:
        """What a person types at a terminal of his own."""
        link = await self.wire.open()
        reply = ""
        link.write(line.encode("latin-1") + b"\r")
        while not reply.endswith((":", "?")):
            reply += (await link.read()).data.decode("latin-1")
        await link.close()
        return reply

    async def ready(self, polls: int = 30) -> None:
        await self.driver.connect()
        await self.driver.configure()
        await self.driver.enable(["x", "y"], True)
        for _ in range(polls):
            await self.driver.poll()
            await sleep_ns(self.clock, 100 * NS_PER_MS)

    async def moved(self, profiles: dict[str, Profile], lead_s: float = 0.5) -> tuple[Any, Any, Any, int]:
        """One step, from lowering to its outcome."""
        driver, mapping = self.driver, self.driver.mapping()
        lowered = driver.lower(profiles, "auto", mapping)
        t0_ns = self.clock.now_ns() + round(lead_s * NS_PER_S)
        await driver.arm(lowered, t0_ns, mapping)
        await driver.verify()
        await driver.go()
        started = await driver.started()
        outcome = await driver.outcome()
        return lowered, started, outcome, t0_ns


def run(
    main: Callable[[World], Coroutine[Any, Any, Any]],
    *,
    seed: int = 1,
    fleet: dict[str, Any] | None = None,
    options: dict[str, Any] | None = None,
    ppm: float = 40.0,
) -> Any:
    async def within(clock: Clock) -> Any:
        config = Controller.model_validate(fleet or FLEET)
        MAKE.check(config)
        oscillator = Oscillator(Random(seed).randrange(10**9), ppm, 0.05, seed)
        timing = Timing(decode_ns=500_000, spread_ns=50_000)
        controller = SMC4000.build(clock, options or {}, oscillator=oscillator, timing=timing, seed=seed)
        wire = MemoryWire(clock, LAN, controller, "tcp", "smc", copy_context(), seed)

        def driver() -> Driver:
            chosen = Options.model_validate(config.options)
            return MAKE.driver(Setup("c", config, chosen, clock, wire.open, LoopFirer(clock)))

        return await main(World(clock, controller, wire, driver(), driver))

    return run_virtual(within)


def trapezoid(start: int, end: int, speed: float, ramp: float, stretch: float = 1.0) -> Profile:
    way = abs(end - start)
    sign = 1 if end > start else -1
    speed = min(speed, (way * ramp) ** 0.5)
    t, hold = speed / ramp, way / speed - speed / ramp
    profile = Profile(start, end, sign * 1.0, [t, max(hold, 0.0), t], [ramp, 0.0, -ramp], [0.0, 0.0, 0.0])
    return profile.stretched(stretch)


def test_a_step_runs_from_connect_to_its_outcome():
    async def main(world: World) -> None:
        identity = await world.driver.connect()
        assert (identity.model, identity.serial) == ("SMC4040", "1")
        await world.ready()
        profiles = {"x": trapezoid(0, 40_000, 80_000, 700_000), "y": trapezoid(0, -20_000, 40_000, 350_000)}
        lowered, started, outcome, t0_ns = await world.moved(profiles)
        assert outcome.state == "done", outcome
        motions = {motion.axis: motion for motion in world.controller.motions}
        for axis, letter in (("x", "X"), ("y", "Y")):
            motion = motions[letter]
            assert started[axis].earliest_ns <= motion.start_ns <= started[axis].latest_ns
            assert outcome.ended[axis].earliest_ns <= motion.end_ns <= outcome.ended[axis].latest_ns
            off_ns = motion.start_ns - t0_ns
            assert sum(t.earliest_ns for t in lowered.terms) <= off_ns <= sum(t.latest_ns for t in lowered.terms)
            assert motion.end_counts == profiles[axis].end_counts

    run(main)


def test_durations_are_predicted_and_spans_hold_over_random_moves_and_drifts():
    figures: list[tuple[float, float, float]] = []

    async def main(world: World) -> None:
        draw = Random(world.wire.seed)
        await world.ready(60)
        at = {"x": 0, "y": 0}
        for _ in range(12):
            profiles: dict[str, Profile] = {}
            for axis in at:
                end = draw.randrange(-200_000, 200_000)
                speed, ramp = draw.uniform(2_000, 99_000), draw.uniform(20_000, 990_000)
                profiles[axis] = trapezoid(at[axis], end, speed, ramp, draw.uniform(1.0, 1.3))
                at[axis] = end
            before = len(world.controller.motions)
            lowered, started, outcome, t0_ns = await world.moved(profiles)
            assert outcome.state == "done", outcome
            motions = {motion.axis: motion for motion in world.controller.motions[before:]}
            for axis, letter in (("x", "X"), ("y", "Y")):
                motion = motions[letter]
                assert started[axis].earliest_ns <= motion.start_ns <= started[axis].latest_ns
                assert outcome.ended[axis].earliest_ns <= motion.end_ns <= outcome.ended[axis].latest_ns
                off_ns = motion.start_ns - t0_ns
                assert sum(t.earliest_ns for t in lowered.terms) <= off_ns <= sum(t.latest_ns for t in lowered.terms)
                real_s = (motion.end_ns - motion.start_ns) * 1e-9
                assert real_s == pytest.approx(lowered.durations_s[axis], abs=lowered.tick_ns * 1e-9)
                assert lowered.durations_s[axis] == pytest.approx(profiles[axis].duration_s, abs=0.51e-9 * lowered.tick_ns)
                figures.append((real_s - profiles[axis].duration_s, started[axis].latest_ns - started[axis].earliest_ns, off_ns))
            for _ in range(3):
                await world.driver.poll()

    for seed, ppm in ((1, 0.0), (2, 90.0), (3, -90.0), (4, 35.0)):
        run(main, seed=seed, ppm=ppm)
    print(max(abs(f[0]) for f in figures), max(f[1] for f in figures), min(f[2] for f in figures), max(f[2] for f in figures))


def test_the_gate_never_opened_means_no_motion():
    async def main(world: World) -> None:
        await world.ready()
        mapping = world.driver.mapping()
        lowered = world.driver.lower({"x": trapezoid(0, 5000, 20_000, 200_000)}, "auto", mapping)
        t0_ns = world.clock.now_ns() + NS_PER_S
        await world.driver.arm(lowered, t0_ns, mapping)
        await sleep_until_ns(world.clock, t0_ns - 10 * NS_PER_MS)
        with pytest.raises(CannotDo) as late:
            await world.driver.go()
        assert late.value.refusal.code == "late"
        with pytest.raises(DriverFault) as fault:
            await world.driver.started()
        assert fault.value.fault.code == "late"
        await sleep_ns(world.clock, NS_PER_S)
        assert not world.controller.motions

    run(main)


@pytest.mark.parametrize("abort", [False, True])
@pytest.mark.parametrize("before_ms", [300, 60, 21, 2, 0])
def test_a_stop_while_armed_keeps_everything_still_or_stops_it(abort: bool, before_ms: int):
    async def main(world: World) -> None:
        await world.ready()
        mapping = world.driver.mapping()
        lowered = world.driver.lower({"x": trapezoid(0, 90_000, 90_000, 900_000)}, "auto", mapping)
        t0_ns = world.clock.now_ns() + NS_PER_S
        await world.driver.arm(lowered, t0_ns, mapping)
        await world.driver.go()
        await sleep_until_ns(world.clock, t0_ns - before_ms * NS_PER_MS)
        await world.driver.stop(abort)
        await sleep_until_ns(world.clock, t0_ns + NS_PER_S)
        assert world.controller.at_rest()
        assert abs(world.controller.position("X")) < 100
        if before_ms >= 21:
            assert not world.controller.motions

    run(main)


def test_disarmed_and_reconnected_units_do_not_start():
    async def main(world: World) -> None:
        await world.ready()
        for way in ("disarm", "reconnect", "other"):
            mapping = world.driver.mapping()
            lowered = world.driver.lower({"x": trapezoid(0, 5000, 20_000, 200_000)}, "auto", mapping)
            t0_ns = world.clock.now_ns() + NS_PER_S
            await world.driver.arm(lowered, t0_ns, mapping)
            await world.driver.go()
            if way == "disarm":
                await world.driver.disarm()
                await world.driver.disarm()
            elif way == "reconnect":
                await world.driver.close()
                await world.driver.connect()
            else:
                await world.other().connect()
            await sleep_until_ns(world.clock, t0_ns + NS_PER_S)
            await world.driver.poll()
            assert not world.controller.motions

    run(main)
