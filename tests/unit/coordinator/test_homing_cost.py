"""The work of homing in an order, counted: it grows with the square of the axes, and not with the third power."""

# pyright: reportPrivateUsage=false

from collections.abc import Callable
from typing import NamedTuple

import pytest

from orchestrator.coordinator.steps.home import _HomingRun
from orchestrator.model.fleet import Fleet
from orchestrator.plan.homing_order import HomingOrder, find_prerequisites
from orchestrator.runtime.simulated_fleets import make_light_fleet

FEW, MANY = 50, 200
MOST_GROWTH = 1.2 * (MANY / FEW) ** 2  # with the third power it is 4 times that


class CountedName(str):
    """A name that counts how often an axis is looked up, or put into a set."""

    looked_up = 0

    def __eq__(self, other: object) -> bool:
        return str.__eq__(self, other)

    def __hash__(self) -> int:
        CountedName.looked_up += 1
        return str.__hash__(self)


class Ordered(NamedTuple):
    """A fleet with the order in which its axes are homed, one after the other."""

    fleet: Fleet
    order: HomingOrder


def make_ordered(count: int) -> Ordered:
    plain = make_light_fleet(count, 4).to_plain()
    for config in plain["controllers"].values():
        config["axes"] = {"x": config["axes"]["x"]}
    entries: list[list[str]] = [[CountedName(f"{name}.x")] for name in plain["controllers"]]
    return Ordered(Fleet.model_validate(plain | {"groups": {}}), HomingOrder(entries, []))


def count_ordering(ordered: Ordered) -> int:
    """The look-ups of finding what each axis waits for."""
    CountedName.looked_up = 0
    waits = find_prerequisites(ordered.fleet, ordered.order)
    assert [len(predecessors) for predecessors in waits.values()] == list(range(len(waits)))
    return CountedName.looked_up


def count_running(ordered: Ordered) -> int:
    """The look-ups of finding which axis is next, until all are homed."""
    waits = find_prerequisites(ordered.fleet, ordered.order)
    run = _HomingRun("job", "anna", waits, frozenset(), {})
    CountedName.looked_up = 0
    while ready := run.find_ready():
        assert ready == ordered.order.entries[len(run.homed)]
        run.homed += ready
    assert len(run.homed) == len(waits)
    return CountedName.looked_up


@pytest.mark.parametrize("count_work", [count_ordering, count_running])
def test_the_work_of_four_times_as_many_axes_is_sixteen_times_as_much(count_work: Callable[[Ordered], int]) -> None:
    few, many = (count_work(make_ordered(count)) for count in (FEW, MANY))
    assert few > FEW**2 / 2  # each is looked up, so that the count is one
    assert many <= MOST_GROWTH * few
