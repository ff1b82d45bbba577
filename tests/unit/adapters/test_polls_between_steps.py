"""Polls beside steps that follow each other: none delays the loading of the next one, and a whole step may lie between
two."""

from types import SimpleNamespace
from typing import Any, cast

import pytest
from unit.adapters.scripted_member import MOVE_NS, T0_NS, Desk, run

from adapters.contract import AxisReading, ControllerReading
from adapters.controller.monitoring.surveillance import Surveillance
from adapters.controller.state.loaded_steps import QUIET_LOADING_NS, QUIET_TURN_NS
from adapters.controller.state.status import ControllerStatus
from orchestrator.clock.base import NS_PER_MS
from orchestrator.model.fleet import Controller

ENDED_NS = T0_NS + MOVE_NS
LATE_T0_NS = ENDED_NS + 2 * QUIET_LOADING_NS
CONFIG = Controller.model_validate(
    {
        "adapter": "smc4000",
        "link": {"kind": "tcp", "host": "127.0.0.1", "port": 1},
        "axes": {"x": {"motors": ["X"], "unit": "counts", "limits": {"velocity": 1, "acceleration": 1}}},
    }
)


def test_no_poll_delays_the_loading_behind_the_end() -> None:
    async def body(desk: Desk) -> None:
        steps, clock = desk.steps, desk.clock
        await desk.move()
        assert (await desk.arm_next(t0_ns=LATE_T0_NS)).waits
        steps.polled_ns, steps.poll_takes_ns = ENDED_NS - 200 * NS_PER_MS, 80 * NS_PER_MS
        until_ns = steps.polled_ns + QUIET_LOADING_NS
        await desk.wait_until(ENDED_NS - QUIET_TURN_NS - 81 * NS_PER_MS)
        assert steps.quiet_until_ns(clock.now_ns()) is None
        await desk.wait_until(ENDED_NS - QUIET_TURN_NS - 80 * NS_PER_MS)  # it would end at the turn
        assert steps.quiet_until_ns(clock.now_ns()) == until_ns
        desk.driver.may_load.clear()
        await desk.end_present()
        # While the following step is loaded: that the end was seen is an answer of the controller.
        until_ns = steps.polled_ns + QUIET_LOADING_NS
        assert steps.polled_ns >= ENDED_NS
        assert steps.quiet_until_ns(clock.now_ns()) == until_ns
        await desk.wait_until(until_ns + NS_PER_MS)  # a controller that is not read counts as silent
        assert steps.quiet_until_ns(clock.now_ns()) is None
        desk.driver.may_load.set()
        await desk.wait_until(LATE_T0_NS + NS_PER_MS)  # it was not released, and is unloaded

    run(body)


@pytest.mark.parametrize(("followed_ns", "jumps"), [(0, ["x"]), (150, [])])
def test_a_whole_step_between_two_polls_is_no_change_by_another_client(followed_ns: int, jumps: list[str]) -> None:
    status = ControllerStatus(CONFIG, faults=[])
    status.referenced["x"] = True
    steps = SimpleNamespace(present=None, is_followed=False, followed_ns=followed_ns)
    publisher = SimpleNamespace(is_moving=False, emit_event=lambda *_: None)
    context = SimpleNamespace(driver=None, clock=None)
    surveillance = Surveillance(*cast(tuple[Any, Any, Any, Any], (context, status, steps, publisher)))
    readings = [
        ControllerReading(at_ns, {"x": AxisReading(counts, float(counts), 0.0, moving=False, enabled=True)})
        for at_ns, counts in ((50, 0), (100, 0), (200, 2000))
    ]
    assert surveillance.find_jumps(None, readings[0]) == []
    assert surveillance.find_jumps(readings[0], readings[1]) == []
    assert surveillance.find_jumps(readings[1], readings[2]) == jumps
