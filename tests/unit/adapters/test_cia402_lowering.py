"""Profiles in whole numbers of a drive's units, and refusals."""

from random import Random
from typing import Any

import pytest
from unit.adapters.cia402_bench import ACCELERATION, VELOCITY, config, profiles

from adapters.cia402 import MAKE
from adapters.cia402.canopen.bus import SHARED
from adapters.cia402.canopen.states import DriveState, drive_state_of
from adapters.cia402.canopen.words import abort_text, emergency_text
from adapters.cia402.driver import Cia402Driver
from adapters.cia402.shapes.trapezoid import DriveBounds, DriveUnits, fit_trapezoid
from adapters.contract import DriverSetup
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.queue import EventQueue
from orchestrator.link.base import Link
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions, TriggerWait
from orchestrator.model.profile import Profile
from orchestrator.plan.step import AxisMove, plan_step


async def _no_link() -> Link:
    raise AssertionError("lowering opens no link")


def _driver(node: int = 1, shared: dict[str, Any] | None = None, **options: Any) -> Cia402Driver:
    its, clock = config(node, options), EventQueue()
    known = {} if shared is None else shared
    parsed = MAKE.options_model.model_validate(its.options)
    return MAKE.create_driver(DriverSetup("d", its, parsed, clock, _no_link, LoopTimedWriter(clock), known))


def test_durations_are_kept_within_the_bounds() -> None:
    draw, bounds, units = Random(1), DriveBounds(VELOCITY, ACCELERATION), DriveUnits(1.0, 1.0)
    for _ in range(300):
        velocity = VELOCITY * draw.uniform(0.02, 0.9)
        acceleration = min(velocity / draw.uniform(0.05, 1.0), ACCELERATION * 0.9)
        way = draw.randrange(500, 400_000)
        profile = plan_step([AxisMove("a", 0, way, velocity, acceleration)]).profiles["a"]
        shape = fit_trapezoid(way, profile.duration_s, profile.peak_velocity, bounds, units)
        assert shape is not None
        assert abs(shape.duration_s - profile.duration_s) < 100e-6
        assert shape.velocity <= VELOCITY
        assert max(shape.acceleration, shape.deceleration) <= ACCELERATION
        covered = sum(leg.duration_s * (leg.speed + leg.duration_s * leg.acceleration / 2) for leg in shape.motion_legs)
        assert covered == pytest.approx(way)


def test_other_units_of_velocity_are_used() -> None:
    shape = fit_trapezoid(40_000, 2.0, 30_000.0, DriveBounds(VELOCITY, ACCELERATION), DriveUnits(10.0, 0.001))
    assert shape is not None
    assert shape.velocity == pytest.approx(300_000, rel=0.01)
    assert shape.acceleration <= ACCELERATION * 0.001
    assert abs(shape.duration_s - 2.0) < 1e-3


def test_a_move_that_is_too_quick_is_answered_with_the_duration_that_it_needs() -> None:
    quick = profiles(0, 40_000)["a"].stretch_time(0.2)
    lowered = _driver().lower_profiles({"a": quick}, StartOptions(), None)
    assert lowered.durations_s["a"] > quick.duration_s * 2
    assert lowered.shape is not None
    assert lowered.shape.velocity <= VELOCITY


def test_an_axis_that_does_not_move_has_no_set_point() -> None:
    lowered = _driver().lower_profiles({"a": Profile(500, 500, 1.0, [], [], [])}, StartOptions(), None)
    assert lowered.durations_s == {"a": 0.0}
    assert lowered.shape is None
    assert lowered.commands == ()


def test_an_impossible_request_is_refused_with_a_remedy() -> None:
    jerky = dict(plan_step([AxisMove("a", 0, 40_000, VELOCITY, ACCELERATION, 4e6, order=3)]).profiles)
    waits = StartOptions(wait=TriggerWait(input="go", earliest_ns=0, latest_ns=1))
    far = {"a": Profile(0, 2**31, float(2**31), [1e5], [0.0], [0.0])}
    for moves, how, code in (
        (jerky, StartOptions(), "jerk"),
        (profiles(0, 100), StartOptions(start_class="clock"), "start-class"),
        (profiles(0, 100), StartOptions(start_class="host"), "start-class"),
        (profiles(0, 100), StartOptions(start_class="line"), "start-class"),
        (profiles(0, 100), waits, "start-class"),
        (far, StartOptions(), "too-far"),
        ({"a": profiles(0, 2)["a"].stretch_time(1e4)}, StartOptions(), "too-slow"),
    ):
        with pytest.raises(Refusal) as caught:
            _driver().lower_profiles(moves, how, None)
        assert caught.value.code == code
        assert caught.value.remedy


def test_drives_of_one_bus_agree_on_the_instant_of_the_sync() -> None:
    shared: dict[str, Any] = {}
    quick = _driver(1, shared, start_us=100, start_spread_us=50)
    slow = _driver(2, shared, start_us=700, start_spread_us=50)
    assert shared[SHARED].start_ns == 400_000
    moves = profiles(0, 1000)
    leads = {driver.lower_profiles(moves, StartOptions(), None).lead_ns for driver in (quick, slow)}
    assert len(leads) == 1
    firmware = [
        (term.earliest_ns, term.latest_ns)
        for driver in (quick, slow)
        for term in driver.lower_profiles(moves, StartOptions(), None).terms
        if term.name == "firmware"
    ]
    assert firmware == [(-350_000, -250_000), (250_000, 350_000)]


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"axes": {"a": {"motors": ["2"]}}}, "motor"),
        ({"axes": {"a": {"homing": {"method": "mark"}}}}, "method"),
        ({"axes": {"a": {"homing": {"method": "99"}}}}, "method"),
        ({"axes": {"a": {"limits": {"velocity": 0.1}}}}, "velocity"),
        ({"inputs": {"go": {"number": 17}}}, "1 to 16"),
        ({"link": {"kind": "tcp", "host": "10.0.0.1", "port": 1}}, "link.kind"),
    ],
)
def test_the_refusal_of_a_wrong_fleet_file_names_what_is_allowed(change: dict[str, Any], words: str) -> None:
    plain = config(1).to_plain()
    for key, value in change.items():
        if key == "axes":
            for field, each in value["a"].items():
                old = plain["axes"]["a"].get(field)
                plain["axes"]["a"][field] = {**old, **each} if isinstance(each, dict) else each
        else:
            plain[key] = value
    with pytest.raises(ValueError, match=words):
        MAKE.check_config(Controller.model_validate(plain))


def test_statuswords_name_their_state_whatever_the_other_bits_are() -> None:
    expected = {
        0x0000: DriveState.NOT_READY,
        0x0040: DriveState.DISABLED,
        0x0250: DriveState.DISABLED,
        0x0631: DriveState.READY,
        0x0633: DriveState.SWITCHED_ON,
        0x1637: DriveState.ENABLED,
        0x0617: DriveState.QUICK_STOP,
        0x021F: DriveState.REACTION,
        0x0218: DriveState.FAULT,
        0x0238: DriveState.FAULT,
    }
    assert {word: drive_state_of(word) for word in expected} == expected


def test_codes_have_words() -> None:
    assert abort_text(0x0609_0030) == "invalid value for parameter (06090030h)"
    assert "does not list" in abort_text(0x1234_5678)
    assert emergency_text(0x8611) == "following error (8611h)"
    assert emergency_text(0x4299) == "device temperature (4299h)"
    assert emergency_text(0xFF42) == "a manufacturer-specific error (FF42h)"
