"""SMC30: lines on the wire, numbers for a wanted time, programs, and the fleet file."""

from math import isclose
from random import Random
from typing import Any

import pytest
from unit.adapters.test_smc30_bench import HOST, World, config, drive, run, wait

from adapters.smc30 import MAKE
from adapters.smc30.frames import ReceivedReply, ReplyReader, frame_line, line_checksum
from adapters.smc30.lowering import DELAY_NS, make_slot_schedule
from adapters.smc30.options import Smc30DriverOptions
from adapters.smc30.ramp import fit_shape, is_allowed
from adapters.smc30.unitaxis import Smc30Bounds
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.plan.step import AxisMove, plan_step
from sim.smc30.profile import trapezoid_profile

GAP_S = 0.002
CHAR_NS = 10 * NS_PER_S // 9600


def texts(reader: ReplyReader, data: bytes) -> list[str | None]:
    return [reply.text for reply in reader.feed_bytes(data, 0)]


# Lines


def test_the_manuals_own_line() -> None:
    assert frame_line("A3", 1, with_checksum=True) == b"1A3%\r"
    assert frame_line("A3", 1, with_checksum=False) == b"1A3\r"
    assert frame_line("E", None, with_checksum=True) == b"EE\r"


def test_replies_with_checksum_are_split_independently_of_their_packets() -> None:
    stream = b"YY\rV25=\rT1000\x15\rE1v\r"
    whole = ["Y", "V25", "T1000", "E1"]
    assert texts(ReplyReader(with_checksum=True), stream) == whole
    reader = ReplyReader(with_checksum=True)
    assert [text for byte in stream for text in texts(reader, bytes([byte]))] == whole


def test_a_checksum_that_is_a_return_is_a_part_of_its_line() -> None:
    text = next(f"V+{n}" for n in range(100_000) if line_checksum(f"V+{n}".encode()) == 13)
    reader = ReplyReader(with_checksum=True)
    assert texts(reader, text.encode() + b"\r") == []
    assert texts(reader, b"\r") == [text]
    # Without the second one it was garbled.
    assert texts(reader, text.encode() + b"\rYY\r") == [None, "Y"]


def test_garbled_lines_are_detected() -> None:
    assert texts(ReplyReader(with_checksum=True), b"YX\r") == [None]
    assert texts(ReplyReader(with_checksum=True), b"Y\r") == [None]
    assert texts(ReplyReader(with_checksum=False), b"V\xb25\rR\r") == [None, "R"]
    assert texts(ReplyReader(with_checksum=False), b"V\x015\r") == [None]
    assert texts(ReplyReader(with_checksum=False), b"x" * 500) == [None]
    assert list(ReplyReader(with_checksum=False).feed_bytes(b"V25\r", 7)) == [ReceivedReply("V25", 7, 4)]


# Numbers


def test_a_ramp_takes_the_time_of_its_profile() -> None:
    draw = Random(3)
    limits = Smc30Bounds(top=8000, acceleration=60_000.0, start_min=50, start_max=900)
    for _ in range(100):
        steps = draw.randrange(50, 60_000)
        duration_s = steps / draw.uniform(60, 3000) + 0.3
        shape = fit_shape(steps, duration_s, draw.uniform(0.02, 0.2), limits, GAP_S)
        assert shape is not None
        assert sum(part.steps for part in shape.parts) == steps
        assert all(is_allowed(part, limits) for part in shape.parts)
        by_unit = sum(trapezoid_profile(part.steps, part.s, part.t, part.r).end_s for part in shape.parts)
        assert isclose(shape.duration_s, by_unit + GAP_S * (len(shape.parts) - 1), abs_tol=1e-9)
        done, rate = shape.state_at(shape.duration_s / 2)
        assert 0 < done < steps
        assert rate <= limits.top
        assert shape.state_at(shape.duration_s + 1) == (steps, 0.0)


def test_several_commands_achieve_a_duration_that_one_cannot() -> None:
    limits = Smc30Bounds(top=5000, acceleration=20_000.0, start_min=16, start_max=200)
    for mean in (16.05, 16.3, 17.5, 21.2, 30.3):
        duration_s = 80 / mean
        shape = fit_shape(80, duration_s, 0.1, limits, GAP_S)
        assert shape is not None
        assert abs(shape.duration_s - duration_s) < 0.2e-3
        # The motor starts at no more than it may start at without a ramp.
        assert all(part.t <= limits.start_max for part in shape.parts)


def test_a_move_that_is_too_slow_gets_the_slowest_possible_one() -> None:
    limits = Smc30Bounds(top=5000, acceleration=20_000.0, start_min=16, start_max=200)
    shape = fit_shape(160, 20.0, 0.1, limits, GAP_S)
    assert shape is not None
    assert shape.duration_s == 10.0


def test_slots_are_whole_delays_and_long_enough() -> None:
    options = Smc30DriverOptions()
    for baud, hold_us in ((9600, 0), (9600, 16_000), (1200, 0), (110, 0)):
        chars = 10 * NS_PER_S // baud
        schedule = make_slot_schedule(options.model_copy(update={"hold_us": hold_us}), chars, 2, 7)
        assert schedule.each_ns % DELAY_NS == 0
        assert schedule.each_ns >= 4 * chars + hold_us * 1000
        assert schedule.delay_ns == 5 * schedule.each_ns
    assert make_slot_schedule(options, CHAR_NS, 0, 7).each_ns == DELAY_NS


# Programs


def test_programs_of_a_bus_differ_in_their_delay_only() -> None:
    async def main(world: World) -> None:
        profiles = dict(plan_step([AxisMove("x", 0, 3000, 5000, 25_000)]).profiles)
        lowered = [driver.lower_profiles(profiles, HOST, None) for driver in world.drivers.values()]
        programs = [each.program for each in lowered]
        assert [program[3] for program in programs] == ["D3", "D2", "D1"]
        assert len({program[:3] + program[4:] for program in programs}) == 1
        # The starting lines are written one slot apart.
        assert [lowered[0].lead_ns - each.lead_ns for each in lowered] == [0, 10 * NS_PER_MS, 20 * NS_PER_MS]

    run(main, (2, 5, 6))


def test_the_text_of_programs() -> None:
    async def main(world: World) -> None:
        driver, _ = world.one
        profiles = dict(plan_step([AxisMove("x", 1000, -2000, 5000, 25_000)]).stretch_to(1.5).profiles)
        program = driver.lower_profiles(profiles, HOST, None).program
        assert [line[0] for line in program] == ["S", "T", "R", "D", "G"]
        assert program[-1] == "G-2000"
        assert driver.lower_profiles(profiles, wait(), None).program[3:] == ("N11.19", "G-2000")
        assert driver.lower_profiles({}, drive(100), None).program == ("S16", "T16", "R1", "D1", "A2", "D10", "C2")
        # A motion longer than the pulse of the trigger line leaves nothing to wait for.
        assert driver.lower_profiles(profiles, drive(100), None).program[3:] == ("D1", "A2", "G-2000", "C2")
        standing = dict(plan_step([AxisMove("x", 5, 6, 5000, 25_000)]).profiles)
        standing["x"].end_counts = 5
        assert driver.lower_profiles(standing, HOST, None).program == ()
        assert driver.lower_profiles(standing, HOST, None).durations_s == {"x": 0.0}

    run(main)


def test_a_measured_rate_is_corrected() -> None:
    async def main(world: World) -> None:
        driver, _ = world.one
        profiles = dict(plan_step([AxisMove("x", 0, 20_000, 5000, 25_000)]).stretch_to(8.0).profiles)
        lowered = driver.lower_profiles(profiles, HOST, None)
        assert lowered.shape is not None
        # Its own seconds are shorter.
        assert isclose(lowered.shape.duration_s, lowered.durations_s["x"] * 1.0005, rel_tol=1e-9)
        assert abs(lowered.durations_s["x"] - 8.0) < 0.2e-3

    run(main, options={"rate_ppm": 500})


def test_an_impossible_move_is_refused_with_what_would_fit() -> None:
    async def main(world: World) -> None:
        driver, _ = world.one

        def refused(move: AxisMove, longer_s: float = 0.0) -> str:
            plan = plan_step([move])
            with pytest.raises(Refusal) as caught:
                driver.lower_profiles(dict(plan.stretch_to(longer_s or plan.duration_s).profiles), HOST, None)
            assert caught.value.remedy
            return caught.value.code

        assert refused(AxisMove("x", 0, 1600, 5000, 25_000), 200.0) == "too-slow"
        assert refused(AxisMove("x", 8_388_000, 8_389_000, 5000, 25_000)) == "too-far"
        assert refused(AxisMove("x", 0, 3000, 5000, 25_000, 100_000, order=3)) == "jerk"

    run(main)


# The fleet file


@pytest.mark.parametrize(
    ("more", "place"),
    [
        ({"link": {"kind": "serial", "device": "/dev/ttyS0", "baud": 9600}}, "data bits"),
        ({"link": {"kind": "serial", "device": "d", "baud": 19200, "data_bits": 7, "parity": "odd"}}, "baud"),
        (
            {"link": {"kind": "serial", "device": "d", "baud": 9600, "data_bits": 7, "parity": "odd", "address": 8}},
            "address",
        ),
        ({"link": {"kind": "udp", "host": "h", "port": 1}}, "link.kind"),
        ({"axis": {"motors": ["2"]}}, "motors"),
        ({"axis": {"homing": {"method": "index"}}}, "homing.method"),
        ({"axis": {"limits": {"velocity": 0.01, "acceleration": 1}}}, "limits.velocity"),
        ({"axis": {"start_rate": {"min": 3, "max": 4}}}, "start_rate"),
        ({"inputs": {"go": {"number": 4}}}, "inputs.go.number"),
        ({"outputs": {"line": {"number": 4}}}, "outputs.line.number"),
        ({"options": {"cheksum": True}}, "cheksum"),
    ],
)
def test_errors_in_the_fleet_file_are_named(more: dict[str, Any], place: str) -> None:
    with pytest.raises(ValueError, match=place):
        MAKE.check_config(config(**more))


def test_a_move_of_less_than_a_step_a_second_is_made_as_slowly_as_the_controller_can() -> None:
    limits = Smc30Bounds(top=5000, acceleration=20_000.0, start_min=16, start_max=200)
    shape = fit_shape(2, 30.0, 0.1, limits, 0.05)
    assert shape is not None
    assert all(is_allowed(ramp, limits) for ramp in shape.parts)
