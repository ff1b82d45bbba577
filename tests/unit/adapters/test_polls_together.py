"""Polls at rest: controllers of one host are polled together, and states of which nothing has changed are not made
again."""

import asyncio
from dataclasses import replace
from fractions import Fraction

from adapters.contract import AxisReading, ControllerReading
from adapters.controller.publishing.axis_states import AxisStates
from adapters.controller.state.poll_timer import MAX_GRID_NS, PollTimer, find_poll_grid_ns
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_MS
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.state import FaultReport
from orchestrator.runtime.simulated_fleets import make_light_fleet

PERIOD_S = 0.2


def test_polls_at_rest_fall_on_the_grid_of_their_host() -> None:
    async def main(clock: VirtualClock) -> None:
        instants_ns: list[int] = []

        async def poll(number: int) -> None:
            timer = PollTimer(clock, find_poll_grid_ns(20))
            for _ in range(3):
                await timer.wait_on_grid(PERIOD_S + 0.0007 * number)
                instants_ns.append(clock.now_ns())

        await asyncio.gather(*map(poll, range(20)))
        assert find_poll_grid_ns(20) == 20 * NS_PER_MS
        assert all(at_ns % (20 * NS_PER_MS) == 0 for at_ns in instants_ns)
        # A wake-up ends the wait at once, a fast poll keeps its own period.
        timer = PollTimer(clock, MAX_GRID_NS)
        begun_ns = clock.now_ns()
        timer.wake_up()
        await timer.wait_on_grid(PERIOD_S)
        assert clock.now_ns() == begun_ns
        await timer.wait(0.0123)
        assert clock.now_ns() - begun_ns == 12_300_000

    run_virtual(main)


def test_the_grid_moves_a_poll_by_no_more_than_an_eighth_of_its_period() -> None:
    async def main(clock: VirtualClock) -> None:
        timer = PollTimer(clock, find_poll_grid_ns(1000))
        for number in range(40):
            begun_ns, period_s = clock.now_ns(), 0.02 + 0.0171 * number
            await timer.wait_on_grid(period_s)
            assert abs((clock.now_ns() - begun_ns) / 1e9 - period_s) <= period_s / 8 + 1e-9

    run_virtual(main)


def test_a_state_is_made_again_when_anything_of_it_has_changed() -> None:
    config = next(iter(make_light_fleet(1, 1).controllers.values()))
    status = ControllerStatus(config)
    states, (name, *_) = AxisStates(config.axes, status), config.axes
    axis_reading = AxisReading(commanded_counts=5, actual_counts=5.0, velocity_counts_s=0.0, moving=False, enabled=True)
    reading = ControllerReading(
        at_ns=1, axes=dict.fromkeys(config.axes, axis_reading), inputs={}, outputs={}, faults=[]
    )
    made = states.make_state(name, reading, None)
    assert states.make_state(name, replace(reading, at_ns=2), None) is made
    fault = FaultReport(code="following", text="", remedy="", axis=name)
    others = [
        states.make_state(
            name, replace(reading, axes={**reading.axes, name: replace(axis_reading, moving=True)}), None
        ),
        states.make_state(name, replace(reading, faults=[fault]), None),
        states.make_state(name, reading, Fraction(1, 3)),
    ]
    status.homing.add(name)
    others.append(states.make_state(name, reading, None))
    status.homing.clear()
    status.braked.add(name)
    others.append(states.make_state(name, reading, None))
    status.braked.clear()
    status.referenced[name] = not status.referenced[name]
    others.append(states.make_state(name, reading, None))
    assert all(state != made for state in others)
    assert len({state.model_dump_json() for state in others}) == len(others)
