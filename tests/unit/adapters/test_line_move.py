"""The interval that holds the end of a move of a controller with text lines: every term widens it."""

from types import SimpleNamespace
from typing import Any, cast

import pytest

from adapters.contract import HostInterval
from adapters.toolkit.lines.move import LineMove
from adapters.toolkit.lines.mover import LineMover
from adapters.toolkit.lines.options import LineOptions
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.clock.virtual import VirtualClock, run_virtual

LATE_NS = 10 * NS_PER_S


class ExampleOptions(LineOptions):
    """100 ppm of the crystal, 500 µs of the end."""

    clock_ppm: float = 100.0
    end_spread_us: int = 500


def find_end(idle_ns: int = LATE_NS, **options: Any) -> HostInterval:
    """The end of a move of 2 s that started between 1.000 s and 1.004 s. idle_ns: of the status that shows rest."""
    lowered = cast(Any, None)  # of another question
    move = LineMove(lowered, t0_ns=NS_PER_S, started=HostInterval(NS_PER_S, NS_PER_S + 4 * NS_PER_MS))
    return move.end_interval(ExampleOptions(**options), 2.0, idle_ns)


def test_spread_and_crystal_widen_the_interval_at_both_ends() -> None:
    # 2 s at 100 ppm are 0.2 ms.
    assert find_end() == HostInterval(3 * NS_PER_S - 700_000, 3 * NS_PER_S + 4_700_000)


@pytest.mark.parametrize("field", ["clock_ppm", "end_spread_us"])
def test_more_of_either_is_never_a_narrower_interval(field: str) -> None:
    wider, exact = find_end(**{field: 1000}), find_end(**{field: 0})
    assert wider.earliest_ns < exact.earliest_ns
    assert wider.latest_ns > exact.latest_ns


def test_a_status_at_rest_ends_it_at_the_latest() -> None:
    idle_ns = 3 * NS_PER_S + NS_PER_MS
    assert find_end(idle_ns) == HostInterval(3 * NS_PER_S - 700_000, idle_ns)
    early_ns = 2 * NS_PER_S
    assert find_end(early_ns) == HostInterval(early_ns, early_ns)


def test_a_long_move_is_looked_at_seldom_until_shortly_before_its_end() -> None:
    """Ten times a second: on a slow line, a stop waits for each look."""
    looks_ns: list[int] = []

    async def main(clock: VirtualClock) -> None:
        async def read_state() -> object:
            looks_ns.append(clock.now_ns())
            state = "idle" if clock.now_ns() >= begin_ns + 2 * NS_PER_S else "moving"
            return SimpleNamespace(
                status=SimpleNamespace(state=state), counts={}, reply=SimpleNamespace(at_ns=clock.now_ns())
            )

        begin_ns = clock.now_ns()
        unit = SimpleNamespace(clock=clock, dialect=None, read_state=read_state)
        mover = LineMover(cast(Any, unit), ExampleOptions())
        lowered = cast(Any, SimpleNamespace(durations_s={"x": 2.0}, moves=()))
        mover.move = LineMove(lowered, t0_ns=begin_ns, started=HostInterval(begin_ns, begin_ns))
        assert (await mover.wait_for_end()).state == "done"
        ends_ns = looks_ns[-1] - begin_ns
        assert 2 * NS_PER_S <= ends_ns <= 2 * NS_PER_S + 20 * NS_PER_MS
        assert len([at_ns for at_ns in looks_ns if at_ns < begin_ns + 1900 * NS_PER_MS]) <= 20

    run_virtual(main)
