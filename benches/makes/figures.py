"""Figures of the lowering benchmarks: percentiles, their targets, and how often each kind of lowering was chosen."""

from collections.abc import Callable
from math import ceil
from typing import NamedTuple


class BenchFigure(NamedTuple):
    """A distance over `n` values, in `unit`. asked: its target, in words; met: whether it is reached."""

    what: str
    n: int
    p50: float
    p99: float
    max: float
    unit: str
    asked: str = ""
    met: bool | None = None


class LoweringChoices(NamedTuple):
    """How many trapezoids of a range of speeds were lowered in which way."""

    cruise: str
    ways: dict[str, int]


class LoweringFigures(NamedTuple):
    """The results of one make."""

    make: str
    moves: int
    figures: list[BenchFigure]
    chosen: list[LoweringChoices]


def make_figure(
    what: str, values: list[float], unit: str, target: str = "", is_met: Callable[[BenchFigure], bool] | None = None
) -> BenchFigure:
    """Compute percentiles by nearest rank."""
    ordered_values = sorted(values)
    p50, p99 = (ordered_values[ceil(share * len(ordered_values)) - 1] for share in (0.5, 0.99))
    figure = BenchFigure(
        what=what,
        n=len(ordered_values),
        p50=round(p50, 4),
        p99=round(p99, 4),
        max=round(ordered_values[-1], 4),
        unit=unit,
        asked=target,
    )
    return figure if is_met is None else figure._replace(met=is_met(figure))
