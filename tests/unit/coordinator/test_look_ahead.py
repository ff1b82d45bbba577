"""Which motion step may be loaded behind another one, and what happens between the two."""

import pytest
from cluster.worlds import demo_fleet, job

from orchestrator.clock.base import NS_PER_MS
from orchestrator.coordinator.jobs.run.look_ahead import BETWEEN_MOST, ChainBreak, NextMotion, find_next_motion
from orchestrator.model.fleet import Fleet
from orchestrator.model.steps.base import Step

MOVE, BACK = "{do: move, to: {gantry.x: 20}}", "{do: move, to: {gantry.x: 0}}"
DWELL = "{do: dwell, duration: 80 ms}"
ON, PULSE = (
    "{do: output, output: gantry.lamp, value: true}",
    "{do: output, output: gantry.lamp, value: true, pulse: 10 ms}",
)
WAIT = "{do: wait, input: gantry.door, timeout: 1 s}"


def parse_steps(*steps: str) -> list[Step]:
    return list(job(f"[{', '.join(steps)}]").steps)


def settling_fleet() -> Fleet:
    plain = demo_fleet().to_plain()
    plain["controllers"]["gantry"]["axes"]["x"] |= {"done": "in_position", "in_position_window": 0.05}
    return Fleet.model_validate(plain)


@pytest.mark.parametrize(
    ("between", "pause_ms", "acts"),
    [
        ([], 0, False),
        ([DWELL], 80, False),
        ([DWELL, DWELL], 160, False),
        ([ON], 0, True),
        ([PULSE, DWELL], 90, True),
    ],
)
def test_dwells_outputs_and_pulses_ride_in_the_gap(between: list[str], pause_ms: int, acts: bool) -> None:
    steps = parse_steps(MOVE, *between, BACK)
    found = find_next_motion(demo_fleet(), steps, 0)
    assert isinstance(found, NextMotion)
    assert (found.index, found.move) == (1 + len(between), steps[-1])
    assert (found.between.pause_ns, found.between.acts) == (pause_ms * NS_PER_MS, acts)


@pytest.mark.parametrize(
    ("between", "reason"),
    [
        ([WAIT], "step 2 (wait) comes before it"),
        (["{do: home, axes: [stage.v]}"], "step 2 (home) comes before it"),
        (["{do: enable, axes: [stage.v]}"], "step 2 (enable) comes before it"),
        (["{do: set-position, axes: {gantry.x: 0}}"], "step 2 (set-position) comes before it"),
        ([DWELL, WAIT, "{do: home, axes: [stage.v]}"], "step 3 (wait) comes before it"),
    ],
)
def test_the_first_step_that_breaks_the_chain_is_named(between: list[str], reason: str) -> None:
    found = find_next_motion(demo_fleet(), parse_steps(MOVE, *between, BACK), 0)
    assert found == ChainBreak(1 + len(between), reason)


@pytest.mark.parametrize(
    ("following", "reason"),
    [
        ("{do: move, to: {gantry.x: 0}, align: 1 s}", "it waits for aligned ticks (`align`)"),
        ("{do: move, to: {gantry.x: 0}, start: line}", "a trigger line starts it (`start: line`)"),
    ],
)
def test_a_step_with_a_start_of_its_own_begins_from_rest(following: str, reason: str) -> None:
    assert find_next_motion(demo_fleet(), parse_steps(MOVE, following), 0) == ChainBreak(1, reason)


def test_only_an_axis_of_the_present_step_must_settle_before_the_next() -> None:
    fleet = settling_fleet()
    settles = find_next_motion(fleet, parse_steps(MOVE, BACK), 0)
    assert settles == ChainBreak(1, "gantry.x must settle in position before it")
    assert isinstance(find_next_motion(fleet, parse_steps("{do: move, to: {stage.u: 2}}", MOVE), 0), NextMotion)


def test_nothing_follows_the_last_motion_step() -> None:
    for rest in ([], [DWELL], [WAIT, ON]):
        assert find_next_motion(demo_fleet(), parse_steps(MOVE, *rest), 0) == ChainBreak(None, "")


@pytest.mark.parametrize(("more", "near"), [(0, True), (1, False)])
def test_the_search_for_the_next_motion_step_has_an_end(more: int, near: bool) -> None:
    found = find_next_motion(demo_fleet(), parse_steps(MOVE, *[DWELL] * (BETWEEN_MOST + more), BACK), 0)
    if near:
        assert isinstance(found, NextMotion) and found.index == BETWEEN_MOST + 1
    else:
        assert found == ChainBreak(None, f"more than {BETWEEN_MOST} steps come before it")


def test_a_point_that_is_not_read_yet_breaks_the_chain() -> None:
    class Unread(list[Step]):
        def __getitem__(self, index: int, /) -> Step:  # type: ignore[override]
            if index == 2:
                raise KeyError(index)
            return super().__getitem__(index)

    found = find_next_motion(demo_fleet(), Unread(parse_steps(MOVE, DWELL, BACK)), 0)
    assert found == ChainBreak(2, "its point is not read yet")
