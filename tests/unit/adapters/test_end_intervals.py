"""Guaranteed intervals of SMC30 and SMC-4000/2000: each term widens them at both ends, with exact figures."""

from types import SimpleNamespace
from typing import Any, cast

from adapters.contract import HostInterval
from adapters.smc30.options import Smc30DriverOptions
from adapters.smc30.timing import Smc30Timing
from adapters.yaskawa.triggers.table import TriggerPlayer
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US


class ExampleRate:
    """A crystal of 100 ppm."""

    def host_duration_ns(self, seconds: float, now_ns: int) -> tuple[int, int]:
        del now_ns
        return round(seconds * 0.9999e9), round(seconds * 1.0001e9)


class ExampleClock:
    """It stands."""

    def now_ns(self) -> int:
        return 0


class ExampleMapping:
    """A millisecond a tick, with different bounds before and behind."""

    def to_host_ns(self, tick: int) -> int:
        return tick * NS_PER_MS

    def bound_at_ns(self, at_ns: int) -> int:
        del at_ns
        return 70_000

    def late_bound_at_ns(self, at_ns: int) -> int:
        del at_ns
        return 90_000


class ExampleSwitches:
    """On at even numbers."""

    output = SimpleNamespace(name="lamp")

    def level_of(self, number: int) -> bool:
        return number % 2 == 0


def find_smc30_end(parts: int, last_busy_ns: int = 0, ready_ns: int = 10 * NS_PER_S) -> HostInterval:
    """The end of a move of 2 s, by a crystal of 100 ppm, in `parts` lines, that started between 1.000 s and 1.004 s."""
    options = Smc30DriverOptions(line_spread_us=300)
    tools = SimpleNamespace(clock=ExampleClock(), crystal=SimpleNamespace(crystal_rate=ExampleRate()))
    shape = SimpleNamespace(duration_s=2.0, parts=[None] * parts)
    start = HostInterval(NS_PER_S, NS_PER_S + 4 * NS_PER_MS)
    move = SimpleNamespace(lowered=SimpleNamespace(shape=shape, drive=None), start=start)
    return Smc30Timing(options, cast(Any, tools)).end_interval(cast(Any, move), last_busy_ns, ready_ns)


def test_an_smc30_ends_within_crystal_and_gaps_of_its_lines() -> None:
    assert find_smc30_end(1) == HostInterval(3 * NS_PER_S - 200_000, 3 * NS_PER_S + 4_200_000)
    # Two gaps of three lines, each of two lines' spread: 2 x 2 x 300 µs.
    assert find_smc30_end(3) == HostInterval(3 * NS_PER_S - 1_400_000, 3 * NS_PER_S + 5_400_000)


def test_an_smc30_ends_after_it_was_busy_and_before_it_is_ready() -> None:
    busy_ns, ready_ns = 3 * NS_PER_S + NS_PER_MS, 3 * NS_PER_S + 2 * NS_PER_MS
    assert find_smc30_end(3, busy_ns, ready_ns) == HostInterval(busy_ns, ready_ns)


def test_an_edge_of_a_table_lies_within_the_bounds_of_the_clock_on_both_sides() -> None:
    played = SimpleNamespace(step=SimpleNamespace(ticks=1000), table=[5, 9], switches=ExampleSwitches())
    options = SimpleNamespace(decode_min_us=100, decode_us=400, output_on_us=20, output_off_us=30)
    table = cast(Any, TriggerPlayer.__new__(TriggerPlayer))
    table._options, table._traits = options, SimpleNamespace(beside=1)
    for number, delay_us in ((0, 20), (1, 30)):
        edge = table._find_edge(played, number, 1000 + played.table[number], ExampleMapping())
        due_ns = (1000 + played.table[number]) * NS_PER_MS
        earliest_ns = due_ns + 2 * 100 * NS_PER_US - 70_000
        latest_ns = due_ns + NS_PER_MS + 2 * 400 * NS_PER_US + 90_000 + delay_us * NS_PER_US
        assert edge == HostInterval(earliest_ns, latest_ns)
