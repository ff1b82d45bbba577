"""The parts of the SMC-4000's adapter by themselves: replies, registers, program, fleet file."""

import re
from dataclasses import astuple
from random import Random
from typing import Any

import pytest
from unit.adapters.test_smc4000_bench import FLEET, LIMITS, World, run, trapezoid

from adapters.yaskawa.common.gate import GateTiming
from adapters.yaskawa.common.options import YaskawaOptions
from adapters.yaskawa.common.program import TABLE, TAIL, VARIABLES, array_name, following_lines, program_lines
from adapters.yaskawa.language.dialect import MAX_LINE
from adapters.yaskawa.shapes.model import RAMP_UNIT, SMC4000, SPEED_UNIT
from adapters.yaskawa.shapes.trapezoid import SampleAlignment, YaskawaBounds, fit_registers
from adapters.yaskawa.smc4000.driver import MAKE
from adapters.yaskawa.wire.exchange import parse_reply
from adapters.yaskawa.wire.record import AXIS_LETTERS
from orchestrator.clock.base import NS_PER_MS, NS_PER_US, sleep_ns
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import StartOptions
from orchestrator.model.profile import Profile

TICK_S = 976_562.5e-9


@pytest.mark.parametrize(
    ("data", "lines", "refused"),
    [
        (b":", [], False),
        (b"?", [], True),
        (b"\r\n:", [], False),
        (b" 0000000100\r\n:", ["0000000100"], False),
        (b"a:b\r\n?003 BGX\r\n 5\r\n:", ["a:b", "?003 BGX", "5"], False),
        (b"#A\r\n\x1a\r\n:", ["#A"], False),
    ],
)
def test_a_reply_is_its_lines_and_its_prompt(data: bytes, lines: list[str], refused: bool):
    parsed = parse_reply(data)
    assert parsed is not None
    assert (parsed.lines, parsed.refused, parsed.used) == (lines, refused, len(data))
    # A question mark that arrived alone in a packet may be the prompt; all other beginnings wait for more.
    assert all(parse_reply(data[:n]) is None or data[n - 1 : n] == b"?" for n in range(1, len(data)))


def test_registers_never_exceed_the_limits_in_host_time():
    draw = Random(7)
    for _ in range(500):
        tick_ns = 976_562.5 * (1 + draw.uniform(-1e-4, 1e-4))
        speed, ramp = draw.uniform(5_000, 100_000), draw.uniform(30_000, 1_000_000)
        profile = trapezoid(0, draw.randrange(1_000, 300_000), speed, ramp, draw.choice((1.0, draw.uniform(1, 1.4))))
        move = fit_registers({"x": profile}, {"x": YaskawaBounds(speed, ramp)}, tick_ns, SMC4000)["x"]
        tick_s = tick_ns * 1e-9
        assert move.speed % 2 == 0 and move.up % 1024 == 0 and move.down % 1024 == 0
        assert move.speed / SPEED_UNIT / tick_s <= speed * (1 + 1e-6)
        assert max(move.up, move.down) / RAMP_UNIT / tick_s**2 <= ramp * (1 + 1e-6)
        assert move.whole_samples >= round(profile.duration_s / tick_s)


def test_a_plan_at_its_limits_is_kept_when_it_is_planned_again_with_the_answer():
    tick_ns = 976_500.0
    profile = trapezoid(0, 100_000, 80_001.0, 500_500.0)
    first = fit_registers({"x": profile}, {"x": YaskawaBounds(80_001.0, 500_500.0)}, tick_ns, SMC4000)["x"]
    answer_s = first.whole_samples * tick_ns * 1e-9
    assert answer_s > profile.duration_s
    again = profile.stretch_time(answer_s / profile.duration_s)
    second = fit_registers({"x": again}, {"x": YaskawaBounds(80_001.0, 500_500.0)}, tick_ns, SMC4000)["x"]
    assert second.whole_samples * tick_ns * 1e-9 == pytest.approx(answer_s, abs=tick_ns * 0.5e-9)


@pytest.mark.parametrize("placed", [False, True])
def test_axes_that_are_fitted_together_equal_each_fitted_alone(placed: bool):
    draw = Random(8)
    coarse = 0
    for _ in range(60):
        profiles, bounds, places = dict[str, Profile](), dict[str, YaskawaBounds](), dict[str, SampleAlignment]()
        for axis in "xyzw":
            # Slow and gentle ones are searched twice.
            speed, ramp = draw.choice([(50.0, 2_000.0), (5e4, 5e5)])
            profiles[axis] = trapezoid(0, draw.randrange(1, round(3 * speed)), speed, ramp, draw.uniform(1, 1.4))
            bounds[axis] = YaskawaBounds(speed, ramp)
            places[axis] = SampleAlignment(draw.uniform(-0.5, 0.5), max(1, round(profiles[axis].duration_s / TICK_S)))
            coarse += speed < 100
        together = fit_registers(profiles, bounds, TICK_S * 1e9, SMC4000, places if placed else None)
        for axis, profile in profiles.items():
            alone = fit_registers({axis: profile}, bounds, TICK_S * 1e9, SMC4000, places if placed else None)
            assert together[axis] == alone[axis]
    assert 60 < coarse < 180


@pytest.mark.parametrize(
    ("profile", "code"),
    [
        (Profile(0, 100, 100.0, [1.0, 1.0], [0.0, 1.0], [1.0, -1.0]), "shape"),
        (Profile(0, 150, 100.0, [1.0, 0.5, 2.0], [1.0, 0.0, -0.5], [0.0] * 3), "shape"),
        (Profile(0, 2**31, 1.0, [1.0, 1.0, 1.0], [2.0**30, 0.0, -(2.0**30)], [0.0] * 3), "too-far"),
    ],
)
def test_profiles_that_do_not_fit_are_refused(profile: Profile, code: str):
    with pytest.raises(Refusal) as refusal:
        fit_registers({"x": profile}, {"x": YaskawaBounds(1e5, 1e6)}, 976_562.5, SMC4000)
    assert refusal.value.code == code
    assert "axis x" in refusal.value.text


@pytest.mark.parametrize(
    ("period_us", "decode_us", "gate"),
    [
        (1000, 500, (9, 6, 10, 19, 27, 10)),
        (250, 100, (33, 11, 27, 60, 91, 24)),  # commands take no less for it
        (1000, 1000, (17, 8, 16, 33, 49, 15)),
        (20000, 500, (1, 5, 5, 6, 7, 6)),
    ],
)
def test_the_gate_leaves_time_for_its_commands_at_any_sample_period(
    period_us: int, decode_us: int, gate: tuple[int, ...]
):
    options = YaskawaOptions(servo_period_us=period_us, decode_us=decode_us, decode_min_us=100)
    found = GateTiming.for_options(options)
    assert astuple(found) == (*gate, max(500, decode_us) * NS_PER_US, 10)


def test_a_following_step_leaves_time_for_the_stamps_of_the_one_before():
    gate = GateTiming.for_options(YaskawaOptions())
    tick_ns = YaskawaOptions().tick_ns
    # One axis of two: twelve commands of half a millisecond, with a sample to see the end and five to spare.
    assert gate.gap_ticks(1, 2, tick_ns) == 13
    assert gate.gap_ticks(4, 4, tick_ns) == 16


def test_the_program_keeps_the_controllers_rules():
    lines = program_lines(4, GateTiming.for_options(YaskawaOptions(servo_period_us=250, decode_us=2000)))
    labels = [line.split(";")[0] for line in lines if line.startswith("#")]
    assert len(lines) <= 2000 and all(len(line) <= MAX_LINE for line in lines)
    assert all(1 < len(label) <= 8 for label in labels) and len(set(labels)) == len(labels)
    assert all(len(name) <= 8 and name[0] == "X" and name[:2] != "XQ" for name in VARIABLES)
    # Nothing stands between the wait and the start.
    waits = [line.partition("WT XT0-TIME;")[2] for line in lines if "WT XT0-TIME;" in line]
    inputs = [line.partition("AI XLI;")[2] for line in lines if "AI XLI;" in line]
    assert len(waits) == 32 and len(inputs) == 31  # one more drives the line
    assert waits[0].startswith("XACT") and waits[-1].startswith("OB XLO") and inputs[0].startswith("XACT")
    assert all(begin.startswith(("BG", "CD XC", "CD ,")) for begin in (*waits[1:-1], *inputs[1:]))
    # A step that follows another one: one entry for each set of axes, and the check right before its wait.
    behind = [line for line in lines if "WT XFT-TIME;" in line]
    assert len(behind) == 15
    assert all(re.fullmatch(r"JP #MISS,XFOK=0;WT XFT-TIME;BG[XYZW]+;XFA=TIME", line) for line in behind)
    checks = [lines[lines.index(line) - 1] for line in behind]
    assert all(check.startswith("XFOK=XFGO&XDONE&(") for check in checks)


@pytest.mark.parametrize("contours", [True, False])
@pytest.mark.parametrize("axes", [1, 2, 3, 4])
def test_the_program_refers_only_to_what_it_has(axes: int, contours: bool):
    lines = program_lines(axes, GateTiming.for_options(YaskawaOptions()), contours=contours)
    text = "\n".join(lines)
    labels = {line.split(";")[0] for line in lines if line.startswith("#")}
    assert {f"#F{mask}" for mask in range(1, 1 << axes)} <= labels
    assert set(re.findall(r"(?:JP ?|JS ?|XQ ?)(#\w+)", text)) <= labels
    arrays = {array_name(index) for index in range(4)} | {TAIL, TABLE}
    names = {name for name in re.findall(r"\bX[A-Z]+[0-9]*\b(?! )", text) if not set(name) <= set(AXIS_LETTERS)}
    assert names - arrays <= {*VARIABLES}
    assert len(VARIABLES) <= 510 and len(labels) <= 510  # L14277, L12254


@pytest.mark.parametrize("mask", [1, 2, 5, 10, 15])
def test_a_following_step_checks_every_axis_and_loads_its_own(mask: int):
    lines = following_lines(mask, 4)
    off = next(line for line in lines if "XOFF=" in line)
    assert all(f"@ABS[_RP{letter}-XB{number}]" in off for number, letter in enumerate("XYZW", 1))
    assert "(XOFF=0)" in lines[lines.index(off) + 1]
    registers = next(line for line in lines if line.startswith("PA "))
    chosen = {f"XP{k + 1}" for k in range(4) if mask >> k & 1}
    assert set(re.findall(r"XP\d", registers)) == chosen
    # A controller of two axes has room for the check on one line.
    assert "XOFF" not in "".join(following_lines(1, 2))


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"link": {"kind": "serial", "device": "/dev/ttyUSB0"}}, "link.baud"),
        ({"axes": {"x": {"motors": ["Q"], "unit": "mm", "limits": LIMITS}}}, "no motor 'Q'"),
        (
            {
                "axes": {
                    "x": {"motors": ["X"], "unit": "mm", "limits": LIMITS},
                    "y": {"motors": ["A"], "unit": "mm", "limits": LIMITS},
                }
            },
            "other name",
        ),
        ({"inputs": {"i": {"number": 9}}}, "inputs.i.number: 9"),
        ({"options": {"nonsense": 1}}, "options.nonsense"),
        ({"options": {"motor_type": {"q": 1}}}, "no axis q"),
        (
            {"axes": {"x": {"motors": ["X"], "unit": "mm", "limits": LIMITS, "homing": {"method": "magic"}}}},
            "homing.method: 'magic'",
        ),
    ],
)
def test_the_fleet_file_is_checked_offline(change: dict[str, Any], words: str):
    with pytest.raises(ValueError, match=words):
        MAKE.check_config(Controller.model_validate(FLEET | change))


@pytest.mark.parametrize("halts", [True, False])
@pytest.mark.parametrize("before_ms", [-300, 1, 300])
def test_a_guardians_bytes_stop_moving_and_waiting_axes(halts: bool, before_ms: int):
    async def main(world: World) -> None:
        await world.ready()
        mapping = world.driver.clock_mapping()
        lowered = world.driver.lower_profiles({"x": trapezoid(0, 90_000, 60_000, 600_000)}, StartOptions(), mapping)
        t0_ns = world.clock.now_ns() + 1000 * NS_PER_MS
        await world.driver.slots.present.load(lowered, t0_ns, mapping)
        await world.driver.slots.present.release()
        await sleep_ns(world.clock, t0_ns - before_ms * NS_PER_MS - world.clock.now_ns())
        link = await world.wire.open_link()
        link.write(MAKE.stop_bytes(Controller.model_validate(FLEET)))
        await sleep_ns(world.clock, 3000 * NS_PER_MS)
        assert world.controller.at_rest()
        assert abs(world.controller.position("X")) < 50_000

    run(main, options={"st_halts_programs": halts})


def test_a_stop_is_sent_on_the_other_handle_when_its_own_is_closed():
    async def main(world: World) -> None:
        await world.ready()
        mapping = world.driver.clock_mapping()
        lowered = world.driver.lower_profiles({"x": trapezoid(0, 90_000, 60_000, 600_000)}, StartOptions(), mapping)
        t0_ns = world.clock.now_ns() + 1000 * NS_PER_MS
        await world.driver.slots.present.load(lowered, t0_ns, mapping)
        await world.driver.slots.present.release()
        world.wire.links[1].hang_up()
        await world.driver.stop(abort=False)
        await sleep_ns(world.clock, 3000 * NS_PER_MS)
        assert not world.controller.commanded_motions
        assert float(await world.driver.send_raw("MG 7")) == 7

    run(main)
