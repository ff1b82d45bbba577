"""Conditions of many controllers with one cause are one alarm, with a count."""

from functools import cache
from typing import Any, cast

import pytest
from unit.controller_states import make_controller_state

from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.coordinator.alarms.common_causes import MANY
from orchestrator.coordinator.alarms.conditions import AlarmConditions
from orchestrator.coordinator.alarms.fleet_sources import FleetAlarms
from orchestrator.coordinator.alarms.folding import FOLD_FROM, RESTORED_NS
from orchestrator.coordinator.alarms.register import AlarmRegister
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.operation.alarms import AlarmCause, AlarmRecord
from orchestrator.model.operation.transitions import raise_alarm, return_alarm
from orchestrator.model.state import FaultReport
from orchestrator.runtime.simulated_fleets import make_light_fleet

FAULT = "fault-hot-c7"
MANY_FAULTS = "many-fault-hot-fleet"


make_fleet = cache(make_light_fleet)


class World:
    """A fleet of light controllers, seen by the sources of alarms; the register keeps each change of an alarm."""

    def __init__(self, count: int, hosts: int = 20) -> None:
        self.fleet = make_fleet(count, hosts)
        self.now = 0
        self.silent: set[str] = set()
        self.records: dict[str, AlarmRecord] = {}
        self.changes: list[AlarmRecord] = []
        self.begin()

    def begin(self) -> None:
        """Begin as a leader that takes over the alarms of the last one."""
        self.conditions = AlarmConditions(cast(AlarmRegister, self), cast(Any, self), lambda: self.fleet)
        for record in self.records.values():
            self.conditions.restore(record, holds=True)
        self.conditions.started = True
        self.source = FleetAlarms(cast(FleetView, self), self.conditions, cast(Any, self))

    # What the sources ask for

    def now_ns(self) -> int:
        return self.now

    def is_silent(self, controller: str) -> bool:
        return controller in self.silent

    def describe_slow_start(self, _: str) -> str | None:
        return None

    def raise_alarm(self, cause: AlarmCause) -> None:
        self._keep(raise_alarm(self.records.get(cause.id), cause, f"{self.now}"))

    def return_alarm(self, alarm_id: str) -> None:
        self._keep(return_alarm(self.records[alarm_id], f"{self.now}"))

    def _keep(self, record: AlarmRecord) -> None:
        if record is not self.records.get(record.id):
            self.changes.append(record)
        self.records[record.id] = record

    # What happens

    @property
    def active(self) -> dict[str, str]:
        """The texts of the alarms whose conditions hold, by id."""
        return {record.id: record.text for record in self.records.values() if record.is_active}

    def see(self, number: int, *codes: str) -> None:
        """A state of a controller, with these faults."""
        state = make_controller_state(f"c{number}", mode="fault" if codes else "idle")
        faults = [FaultReport(code=code, text=f"drive too {code}", remedy="let it cool") for code in codes]
        self.source.take_state(state.model_copy(update={"faults": faults}))

    def pass_s(self, seconds: float) -> None:
        for _ in range(round(seconds)):
            self.now += NS_PER_S
            self.source.tick()
            self.conditions.tick()


def test_a_thousand_faults_in_a_second_are_one_alarm() -> None:
    world = World(1000)
    for number in range(1000):
        if number in (300, 900):
            world.conditions.tick()
        world.see(number, "hot")
        world.now += NS_PER_MS
    world.pass_s(2)
    text = "fault hot: all 1000 controllers (c0, c1, c10 and 997 more); the first: c0: drive too hot"
    assert world.active == {MANY_FAULTS: text}
    assert len(world.changes) == 1 and world.changes[0].action == "let it cool"
    world.pass_s(60)
    assert len(world.changes) == 1
    for number in range(1000):
        world.see(number)
    world.pass_s(7)  # 5 s of `return_after`
    assert world.active == {} and len(world.changes) == 2


def test_a_host_of_fifty_that_is_lost_is_one_alarm_that_returns_with_it() -> None:
    world = World(1000)
    for number in range(1000):
        world.see(number)
    lost = {name for name, config in world.fleet.controllers.items() if config.host == "h3"}
    assert len(lost) == 50
    world.silent = lost
    world.pass_s(13)  # 10 s of `for`
    text = (
        "offline: all 50 controllers of host h3 (c150, c151, c152 and 47 more); "
        "the first: c150 is offline: its adapter is silent"
    )
    assert world.active == {"many-disconnected-h3": text}
    world.silent = set()
    for number in range(150, 200):
        world.see(number)
    world.pass_s(7)
    assert world.active == {} and len(world.changes) == 2


def test_two_hosts_and_two_codes_are_causes_of_their_own() -> None:
    world = World(100, hosts=4)
    for number in range(50):
        world.see(number, "hot" if number % 2 else "cold")
    world.pass_s(2)
    assert world.active.keys() == {"many-fault-hot-fleet", "many-fault-cold-fleet"}
    world.silent = {f"c{number}" for number in range(50)}
    world.pass_s(13)
    assert {"many-disconnected-h0", "many-disconnected-h1"} < world.active.keys()


@pytest.mark.parametrize(("number", "alarms"), [(FOLD_FROM - 1, FOLD_FROM - 1), (FOLD_FROM, 1)])
def test_few_are_alarms_of_their_own(number: int, alarms: int) -> None:
    world = World(MANY + 1)
    for k in range(number):
        world.see(k, "hot")
    assert world.active == {}  # gathered
    world.pass_s(2)
    assert len(world.active) == alarms


def test_in_a_small_fleet_each_is_an_alarm_at_once() -> None:
    world = World(MANY)
    for k in range(MANY):
        world.see(k, "hot")
    assert len(world.active) == MANY and MANY_FAULTS not in world.active


def test_a_fault_that_is_over_before_others_could_come_is_an_alarm_all_the_same() -> None:
    world = World(100)
    world.see(7, "hot")
    world.now += 300 * NS_PER_MS
    world.see(7)
    world.pass_s(2)
    assert world.active.keys() == {FAULT}
    world.pass_s(6)
    assert world.active == {} and world.records[FAULT].state == "returned"


def test_others_join_and_leave_and_the_text_follows_at_most_each_ten_seconds() -> None:
    world = World(1000)
    for number in range(10):
        world.see(number, "hot")
    world.pass_s(2)
    for number in range(10, 400):
        world.see(number, "hot")
        if number % 10 == 0:
            world.pass_s(1)
    assert world.active[MANY_FAULTS].startswith(("fault hot: 381 of 1000 ", "fault hot: 391 of 1000 "))
    assert list(world.active) == [MANY_FAULTS]
    assert len(world.changes) <= 1 + 39 / 10 + 1
    for number in range(1, 400):
        world.see(number)
    world.pass_s(17)
    assert world.active[MANY_FAULTS].startswith("fault hot: 1 of 1000 controllers (c0);")
    world.see(0)
    world.pass_s(7)
    assert world.active == {}


def test_single_ones_that_were_raised_before_stay_what_they_are() -> None:
    world = World(100)
    world.see(7, "hot")
    world.pass_s(3)
    for number in range(50):
        world.see(number, "hot")
    world.pass_s(2)
    assert world.active.keys() == {FAULT, MANY_FAULTS}
    assert world.active[MANY_FAULTS].startswith("fault hot: 49 of 100 ")


def test_a_new_leader_goes_on_with_it_and_ends_one_that_nothing_joins() -> None:
    world = World(100)
    for number in range(50):
        world.see(number, "hot")
    world.pass_s(2)
    world.begin()
    for number in range(30):
        world.see(number, "hot")
    world.pass_s(2)
    assert list(world.active) == [MANY_FAULTS] and world.active[MANY_FAULTS].startswith("fault hot: 30 of 100 ")
    assert [record.state for record in world.changes] == ["unacknowledged"] * 2  # raised, and worded anew
    world.begin()
    world.pass_s(RESTORED_NS // NS_PER_S - 1)
    assert list(world.active) == [MANY_FAULTS]
    world.pass_s(2)
    assert world.active == {}


def test_what_counts_by_itself_is_no_part_of_it() -> None:
    world = World(100)
    world.conditions.folding.is_apart = lambda cause: cause.subject == "c7"
    for number in range(50):
        world.see(number, "hot")
    assert list(world.active) == [FAULT]
    world.pass_s(2)
    assert world.active.keys() == {FAULT, MANY_FAULTS} and world.active[MANY_FAULTS].startswith("fault hot: 49 of 100 ")
