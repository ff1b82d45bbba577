"""The simulated SMC-4000 beyond its vectors: time, programs, power, and bad input."""

import random
from collections.abc import Callable

import pytest
from unit.sim.desk import Desk

from orchestrator.clock.queue import EventQueue
from sim.core.controller import FirmwareTiming, PortRefused
from sim.core.oscillator import Oscillator
from sim.yaskawa import SMC4000

SAMPLE_NS = 976562.5
GATE = (
    "#GOC;'contour, timed start\rI=0;HLT=0;REMN=T0-TIME;JP #LATEC,REMN<5\rCM XYZW;DT NDT\rWT T0-TIME;TACT=TIME\r"
    "#CL;CD DX[I],DX[I],DX[I],DX[I];WC;I=I+1;JP #CL,(I<NS)&(HLT=0)\rDT 0;CD 0;EN\r#LATEC;LATE=1;EN\r"
)


def test_a_move_is_recorded_with_its_true_start_and_end() -> None:
    desk = Desk(oscillator=Oscillator(drift_ppm=100.0))
    desk.ask("SHX", "PRX=25000", "BGX")
    desk.rest()
    (motion,) = desk.unit.commanded_motions
    seconds = 25000 / 25000 + 25000 / 256000
    samples = -(-seconds * 1024 // 1)
    assert motion.end_ns is not None
    assert motion.end_ns - motion.start_ns == pytest.approx(samples * SAMPLE_NS / 1.0001, abs=2)
    assert (motion.start_counts, motion.end_counts) == (0.0, 25000.0)


def test_an_idle_controller_schedules_nothing() -> None:
    desk = Desk()
    desk.ask("SHX", "PRX=1000", "BGX")
    desk.rest()
    assert desk.clock.next_ns() is None


@pytest.mark.parametrize("decode_ns", [0, 500_000])
def test_the_gate_program_runs_its_contour_on_the_controllers_own_clock(decode_ns: int) -> None:
    desk = Desk(timing=FirmwareTiming(decode_ns=decode_ns), oscillator=Oscillator(drift_ppm=-80.0))
    desk.ask(f"DL\r{GATE}\x1a", "DM DX[100]", "QD DX[],0,49\r" + ",".join(["16"] * 50) + "\x1a", "SH", wait_s=0.05)
    desk.ask("NS=50;NDT=3;LATE=0;TACT=0", "T0=TIME+300", "XQ #GOC,0", wait_s=0.05)
    assert desk.ask("MG _HX0{F2.0},LATE{F2.0}", wait_s=0.01) == " 02 00\r\n:"
    desk.rest()
    assert desk.ask("MG TACT-T0{F4.0},_SCX{F3.0},_SCW{F3.0}", wait_s=0.01) == " 0000 051 051\r\n:"
    assert [desk.unit.position(axis) for axis in desk.unit.axis_names] == [800.0] * 4
    for motion in desk.unit.commanded_motions:
        assert motion.end_ns is not None
        assert motion.end_ns - motion.start_ns == pytest.approx(400 * SAMPLE_NS / (1 - 80e-6), abs=2)


def test_an_underrun_holds_the_path() -> None:
    desk = Desk()
    desk.ask("SHX", "CMX", "DT 4", "CD 100")
    desk.wait(0.5)
    assert desk.unit.position("X") == 100.0
    assert desk.ask("MG _BGX{F1.0}") == " 1\r\n:"
    desk.ask("CD 50")
    desk.wait(0.5)
    assert desk.unit.position("X") == 150.0
    assert desk.ask("TC") == " 042\r\n:"
    desk.ask("DT 0;CD 0")
    assert desk.ask("SCX") == " 051\r\n:"


@pytest.mark.parametrize(("then", "counts"), [(("DT 4", "CD 100"), 5100), (("DT 0;CD 0",), 5000)])
def test_a_position_set_before_the_first_record_is_where_the_contour_begins(then: tuple[str, ...], counts: int) -> None:
    """D110; a contour without a record leaves the axis where it stands."""
    desk = Desk()
    desk.ask("SHX", "CMX", "DPX=5000", *then)
    desk.wait(0.5)
    assert desk.unit.position("X") == counts


def test_a_busy_loop_burns_few_events() -> None:
    desk = Desk()
    desk.ask("GO=0", "DL\r#A;SB1\r#G;JP #G,GO=0\rCB1;EN\r\x1a", "XQ #A")
    seen: list[tuple[int, bool]] = []
    desk.unit.on_output(lambda number, level: seen.append((number, level)))
    events, until_ns = 0, desk.clock.now_ns() + 1_000_000_000
    while (due_ns := desk.clock.next_ns()) is not None and due_ns <= until_ns:
        desk.clock.make_next_call()
        events += 1
    assert events <= 1100
    desk.ask("GO=1")
    desk.wait(0.01)
    assert seen == [(1, False)]


def test_threads_share_the_interpreter_line_by_line() -> None:
    desk = Desk(timing=FirmwareTiming(decode_ns=500_000))
    desk.ask("A=0;B=0", "DL\r#A;A=A+1;JP#A\r#B;B=B+1;B=B+1;B=B+1;JP#B\r\x1a", "XQ#A,0;XQ#B,1", wait_s=0.05)
    desk.wait(6.0)
    desk.ask("HX", wait_s=0.05)
    turns = [float(text) for text in desk.ask("MG A{F6.0};MG B/3{F6.0}", wait_s=0.05).replace(":", "").split()]
    assert turns[0] == pytest.approx(turns[1], abs=2)
    assert turns[0] == pytest.approx(6.0 / 0.003, rel=0.02)


def test_power_off_stops_dead_and_power_on_runs_auto() -> None:
    desk = Desk()
    desk.ask("DL\r#AUTO;SB3;EN\r\x1a", "AC 512000", "BP", "BN", "AC 1024", "SHX", "JG 20000", "BGX")
    desk.wait(1.0)
    place = desk.unit.position("X")
    desk.unit.set_power(on=False)
    assert desk.hung_up
    (motion,) = desk.unit.commanded_motions
    assert motion.end_counts == pytest.approx(place, abs=1)
    with pytest.raises(PortRefused):
        desk.open("tcp")
    desk.wait(1.0)
    assert desk.clock.next_ns() is None
    desk.unit.set_power(on=True)
    desk.wait(0.01)
    desk.open("tcp")
    assert desk.unit.output_level(3)
    assert desk.ask("MG TIME{F5.0}") == " 00010\r\n:"
    assert desk.ask("MG _ACX{F7.0},_MOX{F1.0},_RPX{F3.0}") == " 0512000 1 000\r\n:"


def test_the_ninth_handle_is_refused() -> None:
    desk = Desk()
    lines = [desk.unit.connect("tcp", _deaf, _gone) for _ in range(7)]
    with pytest.raises(PortRefused, match="handle"):
        desk.unit.connect("udp", _deaf, _gone)
    lines[3].close()
    desk.unit.connect("udp", _deaf, _gone)
    assert desk.ask("MG _IA2{F1.0},_IHE2{F1.0}") == " 0 1\r\n:"


def _deaf(data: bytes) -> None:
    del data


def _gone() -> None:
    pass


def test_half_lines_wait_for_their_end_and_noise_is_answered() -> None:
    desk = Desk()
    desk.line.receive_bytes(b"PRX=12")
    assert desk.heard == b""
    desk.line.receive_bytes(b"34\rPRX=?\r")
    assert desk.heard == b": 0000001234\r\n:"
    desk.heard = b""
    desk.line.receive_bytes(b"TPX\rXX\rTPX\r")
    assert desk.heard == b" 0000000000\r\n:?"
    assert desk.ask("A" * 81) == "?"
    assert desk.ask("TC1") == "5 Input buffer full\r\n:"
    assert desk.ask("NO " + "x" * 480) == "?"
    assert desk.ask("TC1") == "5 Input buffer full\r\n:"


@pytest.mark.parametrize("port", ["tcp", "serial"])
def test_no_input_crashes_it(port: str) -> None:
    chance = random.Random(7)
    words = [
        *'[](){},;#?"XY*=<>\\',
        "BG",
        "ST",
        "PR=",
        "JG",
        "VM",
        "LI",
        "CR",
        "VP",
        "CD",
        "CM",
        "DT",
        "QD",
        "DL",
        "XQ",
        "MG",
    ]
    words += ["~a", "@SIN", "_TP", "1", "-9", ".5"]
    desk = Desk(port)
    for _ in range(1500):
        if chance.random() < 0.2:
            data = chance.randbytes(chance.randrange(1, 40))
        else:
            data = "".join(chance.choice(words) for _ in range(chance.randrange(1, 8))).encode() + b"\r"
        desk.line.receive_bytes(data)
        desk.wait(0.002)
    desk.line.receive_bytes(b"\x1a\x1a\r")
    desk.ask("HX", "AB", "EO 0", wait_s=0.1)
    assert desk.ask("MG 1{F1.0}", wait_s=0.1).endswith(" 1\r\n:")


def test_a_lost_download_leaves_the_port_usable() -> None:
    desk = Desk()
    desk.line.receive_bytes(b"DL\r#A;SB1\rEN")
    desk.line.close()
    desk.open("tcp")
    assert desk.ask("MG _DL{F3.0}") == " 510\r\n:"


def test_serial_echo_and_messages_of_programs() -> None:
    desk = Desk("serial")
    assert desk.ask("TPX") == "TPX\r\n 0000000000\r\n:"
    desk.ask("EO 0", 'DL\r#A;MG "HELLO";PR 1,2,,,,,5;EN\r\x1a')
    assert desk.ask("XQ") == ':HELLO\r\n?000 #A;MG "HELLO";PR 1,2,,,,,5;EN\r\n'


@pytest.mark.parametrize("options", [{"axes": 3}, {"colour": "red"}, {"handle": "J"}])
def test_a_wrong_option_is_named(options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        SMC4000.build_controller(EventQueue(), options)


def test_a_second_move_in_motion_is_refused_and_ip_extends_it() -> None:
    desk = Desk()
    commands: list[Callable[[], str]] = [lambda: desk.ask("PRX=5"), lambda: desk.ask("IPX=-5")]
    desk.ask("SHX", "PRX=10000", "BGX")
    desk.wait(0.1)
    assert [command() for command in commands] == ["?", "?"]
    desk.ask("IPX=500")
    desk.rest()
    assert desk.unit.position("X") == 10500.0
