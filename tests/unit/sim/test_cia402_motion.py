"""The simulated CiA 402 drive: power states and modes of operation."""

import math
from collections.abc import Mapping

import pytest
from unit.sim.cia402_bench import MS, US, Aborted, CanBench

CONTROL, STATUS = 0x60400010, 0x60410010
TARGET, ACTUAL = 0x607A0020, 0x60640020


def move(bench: CanBench, target: int, extra: int = 0, wait_ms: float = 0.0) -> None:
    """One set-point, with its handshake."""
    bench.write(0x607A, 0, target, 4)
    bench.control(0x0F)
    assert bench.control(0x1F | extra) & 0x1000
    assert not bench.control(0x0F) & 0x1000
    bench.wait(wait_ms)


def test_the_states_in_their_order() -> None:
    bench = CanBench()
    assert bench.status() & 0x4F == 0x40
    assert bench.control(0x07) & 0x4F == 0x40  # nothing can be switched on before shutdown
    assert bench.control(0x06) & 0x6F == 0x21
    assert bench.control(0x07) & 0x6F == 0x23
    assert bench.control(0x0F) & 0x6F == 0x27
    assert bench.control(0x07) & 0x6F == 0x23
    assert bench.control(0x06) & 0x6F == 0x21
    assert bench.control(0x0F) & 0x6F == 0x27
    assert bench.control(0x00) & 0x4F == 0x40


def test_a_profile_position_move_is_the_trapezoid_of_its_objects() -> None:
    bench = CanBench()
    bench.enable(1)
    bench.write(0x6081, 0, 20_000, 4)
    bench.write(0x6083, 0, 100_000, 4)
    bench.write(0x6084, 0, 50_000, 4)
    move(bench, 30_000, wait_ms=3000)
    (motion,) = bench.drive.commanded_motions
    # 0.2 s up over 2,000, 0.4 s down over 4,000, the rest of 24,000 at 20,000 a second
    assert motion.end_ns is not None
    assert (motion.end_ns - motion.start_ns) / 1e9 == pytest.approx(0.2 + 1.2 + 0.4, abs=2e-9)
    assert (motion.start_counts, motion.end_counts) == (0.0, 30_000.0)
    assert bench.read(0x6064, signed=True) == 30_000
    assert bench.status() & 0x400


def test_target_reached_waits_for_the_motor() -> None:
    bench = CanBench(options={"settle_us": 30_000})
    bench.enable(1)
    bench.write(0x6068, 0, 20, 2)
    move(bench, 1000)
    while bench.drive.is_moving("1"):
        bench.wait(0.1)
    assert not bench.status() & 0x400
    bench.wait(40)
    assert not bench.status() & 0x400
    bench.wait(10)
    assert bench.status() & 0x400


def test_a_set_of_set_points_and_one_that_changes_at_once() -> None:
    bench = CanBench()
    bench.enable(1)
    move(bench, 10_000)
    bench.write(0x607A, 0, 5_000, 4)
    assert bench.control(0x1F) & 0x1000
    assert bench.control(0x0F) & 0x1000  # the buffer is full as long as the first one is running
    bench.wait(1200)
    assert not bench.status() & 0x1000
    bench.wait(1000)
    assert [motion.end_counts for motion in bench.drive.commanded_motions] == [10_000.0, 5_000.0]
    move(bench, 100_000)
    bench.wait(100)
    move(bench, -2_000, extra=0x20, wait_ms=4000)
    assert len(bench.drive.commanded_motions) == 3
    assert bench.drive.commanded_motions[-1].end_counts == -2_000.0


def test_relative_set_points_add_to_the_target() -> None:
    bench = CanBench()
    bench.enable(1)
    for _ in range(3):
        move(bench, -700, extra=0x40, wait_ms=500)
    assert bench.drive.position("1") == -2100.0


def test_halt_and_on() -> None:
    bench = CanBench()
    bench.enable(1)
    move(bench, 20_000, wait_ms=500)
    bench.control(0x10F)
    bench.wait(200)
    halted = bench.drive.position("1")
    assert 0 < halted < 20_000
    assert not bench.drive.is_moving("1")
    assert bench.status() & 0x400
    bench.control(0x0F)
    bench.wait(3000)
    assert bench.drive.position("1") == 20_000.0


def test_halt_at_the_target_and_on_is_no_motion() -> None:
    bench = CanBench()
    bench.enable(1)
    move(bench, 2000, wait_ms=1000)
    bench.control(0x10F)
    bench.wait(20)
    bench.control(0x0F)
    bench.wait(100)
    assert bench.drive.position("1") == 2000.0
    assert len(bench.drive.commanded_motions) == 1


def test_profile_velocity() -> None:
    bench = CanBench()
    bench.enable(3)
    assert bench.status() & 0x1000
    bench.write(0x60FF, 0, -5_000, 4)
    bench.wait(200)
    assert bench.drive.velocity("1") == pytest.approx(-5_000)
    assert bench.read(0x606C, signed=True) == -5_000
    assert bench.status() & 0x1400 == 0x400
    bench.write(0x60FF, 0, 0, 4)
    bench.wait(200)
    assert bench.drive.velocity("1") == 0.0
    assert bench.status() & 0x1400 == 0x1400


def test_velocity_runs_up_to_a_software_limit() -> None:
    bench = CanBench()
    bench.write(0x607D, 1, -100, 4)
    bench.write(0x607D, 2, 3_000, 4)
    bench.enable(3)
    bench.write(0x60FF, 0, 5_000, 4)
    bench.wait(2000)
    assert bench.drive.position("1") == 3_000.0
    assert bench.status() & 0x800


def test_a_target_beyond_the_software_limits_is_cut() -> None:
    bench = CanBench()
    bench.write(0x607D, 1, -100, 4)
    bench.write(0x607D, 2, 3_000, 4)
    bench.enable(1)
    move(bench, 9_999, wait_ms=2000)
    assert bench.drive.position("1") == 3_000.0


@pytest.mark.parametrize(
    ("code", "ends", "ramp_s"),
    [
        *((code, 0x40, 0.01) for code in (2, 3, 4)),
        *((code, 0x07, 0.01) for code in (6, 7, 8)),
        *[(1, 0x40, 0.1), (5, 0x07, 0.1), (0, 0x40, 0.0)],
    ],
)
def test_quick_stop_by_its_option_code(code: int, ends: int, ramp_s: float) -> None:
    bench = CanBench()
    bench.write(0x605A, 0, code, 2)
    bench.enable(1)
    move(bench, 1_000_000, wait_ms=500)
    bench.write(0x6040, 0, 0x02, 2)
    bench.wait(300)
    assert bench.status() & 0x4F == ends
    (motion,) = bench.drive.commanded_motions
    assert motion.end_ns is not None
    if ramp_s:
        assert motion.slowing_ns is not None
        assert (motion.end_ns - motion.slowing_ns) / 1e9 == pytest.approx(ramp_s, abs=1e-6)


def test_a_quick_stop_at_rest_is_shown_before_it_switches_off() -> None:
    """A client waits for the state that it has commanded."""
    bench = CanBench()
    bench.write(0x605A, 0, 2, 2)
    bench.write(0x1800, 2, 255, 1)
    bench.send(0x000, b"\x01\x01")
    bench.enable(1)
    began_ns = bench.clock.now_ns()
    bench.write(0x6040, 0, 0x02, 2)
    bench.wait(150)
    words = [int.from_bytes(data[:2], "little") & 0x6F for data in bench.heard(0x181, began_ns)]
    assert words[0] == 0x07 and words[-1] == 0x40


def test_a_polling_client_sees_a_quick_stop_at_rest() -> None:
    """canopen's BaseNode402 reads the statusword eight times until it compares it with this state."""
    bench = CanBench()
    bench.write(0x605A, 0, 2, 2)
    bench.enable(1)
    seen = [bench.control(0x02) & 0x6F] + [bench.status() & 0x6F for _ in range(60)]
    assert seen[:16] == [0x07] * 16 and seen[-1] == 0x40


def test_a_quick_stop_that_is_left_early_does_not_end_the_next_one() -> None:
    bench = CanBench()
    bench.write(0x605A, 0, 2, 2)
    bench.enable(1)
    bench.control(0x02)
    bench.control(0x00)
    for word in (0x06, 0x07, 0x0F, 0x02):
        bench.control(word)
    bench.wait(85)
    assert bench.status() & 0x6F == 0x07
    bench.wait(25)
    assert bench.status() & 0x6F == 0x40


@pytest.mark.parametrize("code", [5, 6, 7, 8])
def test_quick_stop_is_left_by_enabling_where_it_stays(code: int) -> None:
    bench = CanBench()
    bench.write(0x605A, 0, code, 2)
    bench.enable(1)
    assert bench.control(0x02) & 0x6F == 0x07
    assert bench.control(0x0F) & 0x6F == 0x27


def test_a_stalled_motor_faults_by_its_following_error_and_is_reset() -> None:
    bench = CanBench()
    bench.write(0x6065, 0, 500, 4)
    bench.write(0x6066, 0, 10, 2)
    bench.enable(1)
    move(bench, 50_000, wait_ms=200)
    bench.drive.set_stalled("1", stalled=True)
    bench.wait(300)
    assert bench.status() & 0x4F == 0x08
    assert bench.read(0x603F) == 0x8611
    assert bench.heard(0x81)[-1][:3] == bytes([0x11, 0x86, 0x21])
    stood = bench.read(0x6064, signed=True)
    bench.drive.set_stalled("1", stalled=False)
    assert bench.read(0x6064, signed=True) == stood
    assert bench.control(0x0F) & 0x4F == 0x08
    assert bench.control(0x80) & 0x4F == 0x40
    assert bench.heard(0x81)[-1][:3] == b"\0\0\0"
    assert bench.read(0x1003, 1) == 0x8611


def test_a_limit_switch_stops_and_lets_only_back() -> None:
    bench = CanBench(options={"travel": (-1_000.0, 4_000.0)})
    bench.enable(1)
    move(bench, 20_000, wait_ms=1500)
    stood = bench.drive.position("1")
    assert 4_000 < stood < 4_100
    assert bench.read(0x60FD) & 3 == 2
    assert bench.status() & 0x800
    motions = len(bench.drive.commanded_motions)
    move(bench, 20_000, wait_ms=100)
    assert len(bench.drive.commanded_motions) == motions
    move(bench, 0, wait_ms=2000)
    assert bench.drive.position("1") == 0.0
    assert not bench.status() & 0x800


def test_the_enable_input_takes_the_voltage() -> None:
    bench = CanBench(options={"enable_input": 3})
    assert bench.control(0x06) & 0x4F == 0x40
    bench.drive.set_input(3, level=True)
    bench.enable(1)
    move(bench, 50_000, wait_ms=200)
    bench.drive.set_input(3, level=False)
    assert not bench.drive.is_moving("1")
    assert bench.status() & 0x5F == 0x40
    assert bench.read(0x60FD) & 8


def test_inputs_and_outputs() -> None:
    bench = CanBench()
    changes: list[tuple[int, bool]] = []
    bench.drive.on_output(lambda number, level: changes.append((number, level)))
    bench.drive.set_input(1, level=True)
    bench.drive.set_input(8, level=True)
    assert bench.read(0x60FD) >> 16 == 0b1000_0001
    bench.write(0x60FE, 2, 0x0003_0000, 4)
    bench.write(0x60FE, 1, 0x0006_0000, 4)
    assert changes == [(2, True)]
    assert bench.drive.output_level(2)
    bench.drive.set_power(on=False)
    assert changes == [(2, True), (2, False)]


def test_a_push_moves_an_axis_that_is_off_and_nothing_else() -> None:
    bench = CanBench()
    bench.drive.push_axis("1", -350)
    assert bench.read(0x6064, signed=True) == -350
    bench.enable(1)
    with pytest.raises(ValueError, match="keeps torque"):
        bench.drive.push_axis("1", 1)


# Homing: the switch is active from 1000 to 2000, limit switches at -5000 and 5000.

_CAM: Mapping[str, object] = {"travel": (-5_000.0, 5_000.0), "home_switch": (1_000.0, 2_000.0)}
_RIGHT: Mapping[str, object] = {"travel": (-5_000.0, 5_000.0), "home_switch": (1_000.0, None)}
_LEFT: Mapping[str, object] = {"travel": (-5_000.0, 5_000.0), "home_switch": (None, 2_000.0)}


@pytest.mark.parametrize("begin", [-3_000, 1_000, 1_500, 2_000, 3_000])
@pytest.mark.parametrize(
    ("method", "options", "home", "last"),
    [
        (1, _CAM, -4_800, 1),
        (2, _CAM, 4_800, -1),
        (3, _RIGHT, 800, -1),
        (4, _RIGHT, 1_200, 1),
        (5, _LEFT, 2_400, 1),
        (6, _LEFT, 1_600, -1),
        (7, _CAM, 800, -1),
        (8, _CAM, 1_200, 1),
        (9, _CAM, 1_600, -1),
        (10, _CAM, 2_400, 1),
        (11, _CAM, 2_400, 1),
        (12, _CAM, 1_600, -1),
        (13, _CAM, 1_200, 1),
        (14, _CAM, 800, -1),
        (17, _CAM, -5_000, 1),
        (18, _CAM, 5_000, -1),
        (19, _RIGHT, 1_000, -1),
        (20, _RIGHT, 1_000, 1),
        (21, _LEFT, 2_000, 1),
        (22, _LEFT, 2_000, -1),
        (23, _CAM, 1_000, -1),
        (24, _CAM, 1_000, 1),
        (25, _CAM, 2_000, -1),
        (26, _CAM, 2_000, 1),
        (27, _CAM, 2_000, 1),
        (28, _CAM, 2_000, -1),
        (29, _CAM, 1_000, 1),
        (30, _CAM, 1_000, -1),
        (33, _CAM, None, -1),
        (34, _CAM, None, 1),
        (35, _CAM, None, 0),
        (37, _CAM, None, 0),
    ],
)
def test_homing_finds_the_place_of_its_method(
    method: int, options: Mapping[str, object], home: int | None, last: int, begin: int
) -> None:
    bench = CanBench(options={**options, "index_every": 400.0})
    bench.drive.push_axis("1", begin)
    bench.write(0x6098, 0, method, 1)
    bench.write(0x607C, 0, 77, 4)
    bench.enable(6)
    assert bench.status() & 0x3400 == 0x400
    bench.control(0x1F)
    bench.wait(16_000)
    assert bench.status() & 0x3400 == 0x1400
    servo = bench.drive.station.drive.servo
    if home is None:
        turns = begin / 400
        home = begin if not last else 400 * (math.floor(turns) + 1 if last > 0 else math.ceil(turns) - 1)
    # zero lies the home offset away from the home position
    assert servo.offset == pytest.approx(-77 - home)
    # the last move is slow, in the direction of the method, and ends by the ramp just after the place
    beyond = last * (servo.mechanical_position - home)
    assert beyond == pytest.approx(500**2 / (2 * 100_000) if last else 0, abs=1e-3)


def test_homing_that_finds_no_switch_ends_in_an_error() -> None:
    bench = CanBench(options={"travel": (-5_000.0, 5_000.0)})
    bench.write(0x6098, 0, 24, 1)
    bench.enable(6)
    bench.control(0x1F)
    bench.wait(8000)
    assert bench.status() & 0x3400 == 0x2400
    assert bench.heard(0x81)[-1][:2] == bytes([0x13, 0x86])


def test_homing_is_interrupted_by_its_bit() -> None:
    bench = CanBench(options=_CAM)
    bench.write(0x6098, 0, 17, 1)
    bench.enable(6)
    bench.control(0x1F)
    bench.wait(100)
    bench.control(0x0F)
    bench.wait(200)
    assert not bench.drive.is_moving("1")
    assert bench.status() & 0x3400 == 0x400


def test_a_homing_continues_after_halt() -> None:
    bench = CanBench(options=_CAM)
    bench.write(0x6098, 0, 17, 1)
    bench.enable(6)
    bench.control(0x1F)
    bench.wait(100)
    bench.control(0x11F)
    bench.wait(300)
    assert not bench.drive.is_moving("1")
    bench.control(0x1F)
    bench.wait(8000)
    assert bench.status() & 0x3400 == 0x1400


@pytest.mark.parametrize("method", [0, 15, 16, 31, 32, 36, 38])
def test_a_method_that_is_reserved_is_refused(method: int) -> None:
    bench = CanBench()
    with pytest.raises(Aborted, match="0x06090030"):
        bench.write(0x6098, 0, method, 1)


# Interpolated modes


def follow(bench: CanBench, rpdo: int, targets: list[int], period_ms: float, control: bytes = b"") -> None:
    for target in targets:
        bench.send(rpdo, control + target.to_bytes(4, "little", signed=True))
        bench.send(0x80)
        bench.wait(period_ms)


def path(points: int) -> list[int]:
    """Up and to rest at 10,000, like a cosine."""
    return [round(5_000 * (1 - math.cos(math.pi * n / points))) for n in range(points + 1)]


def test_cyclic_synchronous_position_follows_in_straight_pieces() -> None:
    bench = CanBench()
    rpdo = bench.map(True, 3, [TARGET], 1)
    bench.write(0x60C2, 1, 10, 1)
    bench.enable(8)
    bench.start()
    targets = path(50)
    seen: list[float] = []
    for target in targets:
        follow(bench, rpdo, [target], 10)
        seen.append(bench.drive.position("1"))
    # SYNC takes effect some 0.1 ms after it was sent: at the end of a period the piece is all but done
    assert max(abs(a - b) for a, b in zip(seen, targets, strict=True)) < 5_000 * math.pi / 500 * 0.5
    follow(bench, rpdo, [10_000] * 3, 10)
    assert bench.drive.position("1") == 10_000.0
    (motion,) = bench.drive.commanded_motions
    assert motion.end_ns is not None
    assert (motion.end_ns - motion.start_ns) / 1e9 == pytest.approx(0.5, abs=2e-4)


def test_interpolated_position_needs_its_bit() -> None:
    bench = CanBench()
    rpdo = bench.map(True, 3, [0x60C10120], 1)
    bench.write(0x60C2, 1, 10, 1)
    bench.enable(7)
    bench.start()
    follow(bench, rpdo, [100, 200], 10)
    assert bench.drive.position("1") == 0.0
    assert bench.control(0x1F) & 0x1000
    follow(bench, rpdo, [0, 100, 200, 200], 10)
    assert bench.drive.position("1") == 200.0


def test_without_sync_in_motion_the_drive_faults() -> None:
    bench = CanBench()
    rpdo = bench.map(True, 3, [TARGET], 1)
    bench.write(0x60C2, 1, 10, 1)
    bench.enable(8)
    bench.start()
    follow(bench, rpdo, [100, 200, 300], 10)
    bench.wait(40)
    assert bench.status() & 0x4F == 0x08
    assert bench.read(0x603F) == 0x8700


def test_one_sync_starts_all_drives_of_a_bus() -> None:
    bench = CanBench(8)
    rpdos = [bench.map(True, 1, [CONTROL], 0, node) for node in range(1, 9)]
    for node in range(1, 9):
        bench.enable(1, node)
        bench.write(0x607A, 0, 5_000, 4, node)
    bench.start()
    for rpdo in rpdos:
        bench.send(rpdo, b"\x1f\0")
    bench.wait(20)
    assert bench.bus.clock is bench.clock
    assert not any(unit.commanded_motions for unit in bench.units)
    sync_ns = bench.clock.now_ns()
    bench.send(0x80)
    bench.wait(20)
    starts = [unit.commanded_motions[0].start_ns for unit in bench.units]
    # SYNC without data is 47 bits and some; 15 to 25 µs of firmware; up to 100 µs until the next tick of the loop
    assert min(starts) > sync_ns + 60 * US
    assert max(starts) < sync_ns + (60 + 25 + 100) * US
    assert max(starts) - min(starts) < 110 * US


def test_the_crystal_makes_a_move_long_or_short() -> None:
    bench = CanBench(drift_ppm=[100.0])
    bench.enable(1)
    move(bench, 10_000, wait_ms=2000)
    (motion,) = bench.drive.commanded_motions
    assert motion.end_ns is not None
    assert motion.end_ns - motion.start_ns == pytest.approx(1.1e9 / (1 + 100e-6), abs=2)


def test_factors_scale_velocity_and_acceleration() -> None:
    bench = CanBench(options={"objects": {"6096:1": 10, "6097:1": 100}})
    bench.enable(1)
    bench.write(0x6081, 0, 1_000, 4)
    bench.write(0x6083, 0, 1_000, 4)
    bench.write(0x6084, 0, 1_000, 4)
    move(bench, 10_000, wait_ms=1500)
    (motion,) = bench.drive.commanded_motions
    assert motion.end_ns is not None
    assert motion.end_ns - motion.start_ns == pytest.approx(1.1 * 1e9, abs=2)
    with pytest.raises(Aborted, match="0x08000022"):
        bench.write(0x6096, 1, 1, 4)


def test_a_mode_or_profile_that_is_not_there_is_refused() -> None:
    bench = CanBench()
    for index, sub, value, size in ((0x6060, 0, 4, 1), (0x6086, 0, 3, 2), (0x6083, 0, 0, 4), (0x60C2, 2, -7, 1)):
        with pytest.raises(Aborted, match="0x06090030"):
            bench.write(index, sub, value, size)


def test_power_off_in_a_move_stops_dead_and_boots_again() -> None:
    bench = CanBench()
    bench.enable(1)
    move(bench, 50_000, wait_ms=300)
    bench.drive.set_power(on=False)
    assert not bench.drive.is_moving("1")
    assert bench.drive.at_rest()
    bench.wait(1000)
    bench.drive.set_power(on=True)
    since_ns = bench.clock.now_ns()
    bench.wait(199)
    assert bench.heard(0x701, since_ns) == []
    bench.wait(2)
    assert bench.heard(0x701, since_ns) == [b"\0"]
    assert bench.read(0x6064, signed=True) == 0
    assert bench.clock.now_ns() > 1000 * MS


def test_a_slow_path_with_periods_of_rest_is_one_motion() -> None:
    bench = CanBench()
    rpdo = bench.map(True, 3, [TARGET], 1)
    bench.write(0x60C2, 1, 10, 1)
    bench.enable(8)
    bench.start()
    follow(bench, rpdo, [1, 1, 1, 2, 2, 3, 5, 8, 9, 9, 9, 9, 10], 10)
    bench.wait(10)
    follow(bench, rpdo, [10] * 55, 10)
    (motion,) = bench.drive.commanded_motions
    assert motion.end_ns is not None
    assert (motion.end_ns - motion.start_ns) / 1e9 == pytest.approx(0.13, abs=2e-4)
    # A motion that starts half a second later is another one.
    follow(bench, rpdo, [20, 20], 10)
    assert [(each.start_counts, each.end_counts) for each in bench.drive.commanded_motions] == [
        (0.0, 10.0),
        (10.0, 20.0),
    ]


def test_a_mode_that_the_drive_does_not_have_is_refused_and_not_in_its_list() -> None:
    bench = CanBench(options={"modes": [1, 6, 7]})
    assert bench.read(0x6502) == 0x61
    with pytest.raises(Aborted, match="0x06090030"):
        bench.write(0x6060, 0, 8, 1)
    bench.write(0x6060, 0, 7, 1)


@pytest.mark.parametrize("patience_ms", [0, 10])
@pytest.mark.parametrize("way", [50_000, -50_000])
def test_a_stalled_motor_is_a_following_error_at_once_or_after_its_time(way: int, patience_ms: int) -> None:
    bench = CanBench(options={"objects": {"6065": 500, "6066": patience_ms}})
    bench.enable(1)
    bench.write(0x6081, 0, 20_000, 4)
    move(bench, way, wait_ms=400)
    bench.drive.set_stalled("1", stalled=True)
    # 500 units at 20,000/s
    bench.wait(24)
    assert bench.status() & 0x4F != 0x08
    bench.wait(patience_ms + 10)
    assert bench.status() & 0x4F in (0x08, 0x0F)
    assert bench.read(0x603F) == 0x8611
