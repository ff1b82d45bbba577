"""What raises alarms: limit switches, clocks, following errors; delays on and off; and floods."""

from typing import Any, cast

from cluster.worlds import demo_fleet

from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.alarms.conditions import AlarmConditions
from orchestrator.coordinator.alarms.fleet_sources import FleetAlarms
from orchestrator.coordinator.alarms.motion_sources import FollowingTrend
from orchestrator.coordinator.alarms.register import AlarmRegister
from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.alarm_rules import AlarmRules, FollowingRule
from orchestrator.model.fleet import Fleet
from orchestrator.model.operation.alarms import AlarmCause
from orchestrator.model.state import AxisState, ClockQuality, ControllerState, FaultReport, Mode


class World:
    """A fleet's view with silent controllers, a clock by hand, and a register that only notes."""

    def __init__(self, **rules: Any) -> None:
        self.fleet = Fleet.model_validate(demo_fleet().to_plain() | {"alarms": rules})
        self.now = 0
        self.open: set[str] = set()
        self.raised = 0
        self.silent: set[str] = set()
        self.conditions = AlarmConditions(cast(AlarmRegister, self), cast(Any, self), lambda: self.fleet)
        self.conditions.started = True
        self.source = FleetAlarms(cast(FleetView, self), self.conditions, cast(Any, self))

    def now_ns(self) -> int:
        return self.now

    def describe_slow_start(self, _: str) -> str | None:
        return None

    def is_silent(self, controller: str) -> bool:
        return controller in self.silent

    def raise_alarm(self, cause: AlarmCause) -> None:
        self.open.add(cause.id)
        self.raised += 1

    def return_alarm(self, alarm_id: str) -> None:
        self.open.discard(alarm_id)

    def pass_s(self, seconds: int) -> set[str]:
        """Let time pass, second by second; the alarms that are raised then."""
        for _ in range(seconds):
            self.now += NS_PER_S
            self.source.tick()
            self.conditions.tick()
        return self.open

    def see(self, mode: Mode = "idle", *codes: str, bound_ns: int = 0, **axis: Any) -> set[str]:
        """A state of the gantry; the alarms that are raised then."""
        fields = {"position": 0.0, "commanded": 0.0, "velocity": 0.0, "motor_position": 0.0, "raw_counts": 0.0}
        fields |= {"commanded_counts": 0, "unit": "mm", "moving": False, "enabled": True, "referenced": True}
        state = ControllerState(
            controller="gantry", instance="i", seq=1, utc="", fleet_ns=0, mode=mode,
            axes={"x": AxisState.model_validate(fields | axis)}, inputs={}, outputs={},
            faults=[FaultReport(code=each, text=each, remedy="r") for each in codes],
            clock=ClockQuality(bound_ns=bound_ns, age_ns=0, samples=1), estop=None, epoch=1, digest="",
        )  # fmt: skip
        self.source.take_state(state)
        return self.open


def test_an_alarm_waits_for_its_delay_and_does_not_flap() -> None:
    world = World(disconnected={"for": "3 s", "return_after": "4 s"})
    for _ in range(5):  # shorter than the delay, again and again
        world.see("offline")
        assert world.pass_s(2) == set()
        world.see("idle")
        world.pass_s(1)
    world.see("offline")
    assert world.pass_s(3) == {"disconnected-gantry"}
    for _ in range(5):  # back for less than the other delay
        world.see("idle")
        world.pass_s(2)
        world.see("offline")
        assert world.pass_s(1) == {"disconnected-gantry"}
    world.see("idle")
    assert world.pass_s(3) == {"disconnected-gantry"}
    assert world.pass_s(1) == set() and world.raised == 1


def test_an_adapter_that_is_silent_is_disconnected_too() -> None:
    world = World(disconnected={"for": "2 s", "return_after": "0 s"})
    world.see("idle")
    world.silent = {"gantry"}
    assert world.pass_s(3) == {"disconnected-gantry"}
    world.silent = set()
    assert world.see("idle") == set()


def test_what_is_not_known_of_an_offline_controller_does_not_return() -> None:
    world = World(fault={"return_after": "0 s"}, disconnected={"for": "0 s", "return_after": "0 s"})
    assert world.see("fault", "amplifier") == {"fault-amplifier-gantry"}
    assert world.see("offline", "no-answer", "starting") == {
        "fault-amplifier-gantry",
        "disconnected-gantry",
        "fault-no-answer-gantry",
    }
    assert world.see("fault", "amplifier") == {"fault-amplifier-gantry"}
    assert world.see("idle") == set()


def test_a_limit_switch_counts_only_where_no_homing_reaches_it() -> None:
    world = World(limit_switch={"return_after": "0 s"})
    assert world.see("homing", limit="reverse", homing=True, referenced=False) == set()
    assert world.see("idle", limit="reverse") == set()
    assert world.see("idle") == set()
    assert world.see("moving", limit="forward") == {"limit-switch-gantry_x"}
    assert world.see("idle") == set()
    assert world.see("jogging", limit="forward", referenced=False) == set()


def test_a_clock_is_an_alarm_after_it_was_wide_for_long() -> None:
    world = World(clock_bound={"limit": "1 ms", "for": "10 s"})
    world.see(bound_ns=2_000_000)
    assert world.pass_s(9) == set()
    world.see(bound_ns=3_000_000)
    assert world.pass_s(1) == {"clock-bound-gantry"}
    world.see(bound_ns=900_000)
    assert world.pass_s(6) == set()


def test_a_flood_of_fault_codes_is_bounded() -> None:
    world = World()
    for number in range(300):
        world.see("fault", *(f"c{number}-{each}" for each in range(50)))
        world.pass_s(1)
    assert len(world.open) <= 20 * 6


def test_a_rule_that_is_off_raises_nothing() -> None:
    assert World(fault={"enabled": False}).see("fault", "amplifier") == set()


def test_a_following_error_is_compared_at_its_speed() -> None:
    rule = FollowingRule(moves=5)
    trend = FollowingTrend(5)

    def add(lag_s: float, speed: float, moves: int) -> str | None:
        for _ in range(moves):
            trend.add_move(lag_s, lag_s * speed)
        return trend.explain_growth(rule, None, 1e-3)

    assert add(0.01, 10, 20) is None
    assert add(0.01, 100, 20) is None  # ten times as fast, ten times the error, the same lag
    assert add(0.019, 10, 5) is None
    assert "times its earlier mean" in (add(0.03, 10, 5) or "")
    small = FollowingTrend(5)
    for _ in range(10):
        small.add_move(0.01, 0.4)
    assert small.explain_growth(rule, 0.7, 1e-3) == "is 0.4 in the mean of 5 moves, 57% of what is permitted"
    assert small.explain_growth(rule, 0.9, 1e-3) is None and small.explain_growth(rule, 0.7, 0.5) is None


def test_every_kind_of_alarm_has_its_rule() -> None:
    world = World()
    for field in AlarmRules.model_fields:
        cause = AlarmCause(field.replace("_", "-"), "gantry", "", "")
        assert world.conditions.find_rule(cause) is getattr(world.fleet.alarms, field)
    other = AlarmCause("disk", "gantry", "", "", source="recorder/r1")
    assert world.conditions.find_rule(other) is world.fleet.alarms.other
