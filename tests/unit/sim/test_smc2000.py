"""The simulated SMC-2000 beyond its vectors: echo, chain, shared clock, limits, refusals, ports and noise."""

import random

import pytest

from orchestrator.clock.queue import EventQueue
from sim.core.controller import FirmwareTiming, PortConnection, PortRefused, SimulatedController
from sim.core.oscillator import Oscillator
from sim.yaskawa import SMC2000
from sim.yaskawa.base.errors import SMC2000 as TEXTS
from sim.yaskawa.smc2000.chain import DaisyChain

SAMPLE_NS = 976562.5
HOP_NS = 520_833
PAIR = [{"address": 0, "axes": 4}, {"address": 1, "axes": 2}]


class Desk:
    """A host on the serial port of a controller or a chain, on virtual time."""

    def __init__(
        self,
        timing: FirmwareTiming | None = None,
        oscillator: Oscillator | None = None,
        echo: bool = False,
        **options: object,
    ) -> None:
        self.clock = EventQueue()
        given = {"echo": echo, **options}
        self.unit: SimulatedController = SMC2000.build_controller(
            self.clock, given, timing=timing, oscillator=oscillator
        )
        self.heard = b""
        self.hung_up = False
        self.line = self.open("serial")

    def open(self, port: str) -> PortConnection:
        def closed() -> None:
            self.hung_up = True

        return self.unit.connect(port, self._hear, closed)

    def _hear(self, data: bytes) -> None:
        self.heard += data

    def ask(self, *commands: str, wait_s: float = 0.0) -> str:
        for command in commands:
            self.heard = b""
            self.line.receive_bytes((command if command.endswith(("\r", "\\")) else f"{command}\r").encode("latin-1"))
            self.wait(wait_s)
        return self.heard.decode("latin-1")

    def number(self, expression: str, wait_s: float = 0.0) -> float:
        return float(self.ask(f"MG {expression}", wait_s=wait_s).split("\r\n", maxsplit=1)[0])

    def code(self) -> int:
        return int(self.ask("TC0").removesuffix("\r\n:"))

    def wait(self, seconds: float) -> None:
        self.clock.run_until_ns(self.clock.now_ns() + round(seconds * 1e9))

    def rest(self) -> None:
        while not self.unit.at_rest():
            assert self.clock.make_next_call()

    @property
    def chain(self) -> DaisyChain:
        assert isinstance(self.unit, DaisyChain)
        return self.unit


# One controller and its port


def test_echo_comes_first_byte_by_byte_and_is_on_by_default() -> None:
    clock = EventQueue()
    unit = SMC2000.build_controller(clock, {})
    heard: list[bytes] = []
    line = unit.connect("serial", heard.append, lambda: None)
    line.receive_bytes(b"TP")
    assert b"".join(heard) == b"TP"
    line.receive_bytes(b"X\rXX;")
    assert b"".join(heard) == b"TPX\r 0000000000\r\n:XX;?"


def test_semicolon_ends_a_command_and_an_error_does_not_stop_the_rest() -> None:
    desk = Desk()
    assert desk.ask("PR 5;") == "::"
    assert desk.ask('XX;MG 1{F1.0};MG "a;b"') == "? 1\r\n:a;b\r\n:"
    assert desk.ask("\n") == ":"
    assert desk.ask("NO anything;MG 2{F1.0}") == ": 2\r\n:"


def test_decode_takes_the_firmwares_time() -> None:
    desk = Desk(timing=FirmwareTiming(decode_ns=500_000))
    desk.line.receive_bytes(b"TPX\r")
    desk.wait(0.0004)
    assert desk.heard == b""
    desk.wait(0.0002)
    assert desk.heard == b" 0000000000\r\n:"


def test_a_trip_point_from_the_port_holds_what_follows_and_too_much_is_lost() -> None:
    desk = Desk()
    assert desk.ask("WT 1024", "MG 1{F1.0}") == ""
    for _ in range(60):
        desk.ask("PR 1,2,3")
    assert desk.heard == b"?"
    desk.wait(1.1)
    assert desk.heard.startswith(b"?: 1\r\n::::")
    assert desk.ask("WT 5", "TC0", wait_s=0.1) == " 005\r\n:"


def test_error_texts_are_those_of_the_make() -> None:
    desk = Desk()
    assert desk.ask("bg", "TC1") == "1 Unrecognized command\r\n:"
    assert desk.ask("ET[257]=1", "TC1") == "101 Improper index to ET (must be 0-256)\r\n:"
    assert desk.ask("MG _QQX", "TC1").startswith("58 Unrecognized command in a command response")
    assert desk.ask("TC1") == "0\r\n:"
    assert not {33, 63, 97, 120, 130} & TEXTS.keys()


@pytest.mark.parametrize(
    ("command", "code"),
    [
        ("IF 1", 1),
        ("BK 3", 1),
        ("TH", 1),
        ("~a=1", 1),
        ("MG @TAN[1]", 57),
        ("MG _BKX", 58),
        ("PRE=1", 4),
        ("BGT", 28),
        ("SP 8000002", 6),
        ("SP -2", 6),
        ("KP 1024", 6),
        ("TM 375", 6),
        ("TW -2", 6),
        ("CD 1", 8),
        ("DV ?", 51),
        ("TE ?", 51),
        ("SB 9", 6),
        ("OP ,1", 6),
        ("TI1", 6),
        ("MG @IN[9]", 56),
        ("MG @AN[8]", 56),
        ("XQ #NONE,4", 6),
        ("HX 4", 6),
        ("CI 1", 2),
        ("EN", 2),
        ("CC 1201,0,0,0", 6),
        ("AEX=4096", 114),
        ("MM 100", 1),
        ("EB 1", 102),
        ("PW A,B", 4),
        ("LC BAD,1", 4),
        ("LC 00000000,3", 6),
        ("DM A[8001]", 66),
        ("RC 1", 81),
        ("RA A[]", 82),
    ],
)
def test_refusals(command: str, code: int) -> None:
    desk = Desk()
    assert desk.ask(command) == "?"
    assert desk.code() == code


def test_limits_of_the_memory() -> None:
    desk = Desk()
    assert [desk.number(f"_{op}") for op in ("DL", "UL", "DA", "DM", "LM")] == [254, 254, 30, 8000, 511]
    assert desk.ask("DL\r" + "EN\r" * 1001 + "\\") == "?"
    assert desk.code() == 60
    assert desk.ask("DL\r" + "".join(f"#L{number}\r" for number in range(255)) + "\\") == "?"
    assert desk.code() == 62
    for number in range(254):
        assert desk.ask(f"V{number}=1") == ":"
    assert desk.ask("V254=1") == "?"
    assert desk.code() == 67
    for number in range(31):
        desk.ask(f"DM A{number}[1]")
    assert desk.code() == 67
    for _ in range(511):
        desk.ask("VP 100,100" if desk.number("_LM") % 2 else "VP 0,0")
    assert desk.ask("VP 0,0") == "?"
    assert desk.code() == 32


@pytest.mark.parametrize(("axes", "least"), [(1, 250), (2, 375), (4, 500), (8, 875)])
def test_models_by_their_axes(axes: int, least: int) -> None:
    desk = Desk(axes=axes)
    assert len(desk.unit.axis_names) == axes
    assert desk.ask("TP").count(",") == axes - 1
    assert desk.ask(f"TM {least}") == ":"
    assert desk.ask(f"TM {least - 125}") == "?"
    assert desk.ask("\x12\x16").startswith(f"SMC-2000-{axes} Rev 2.0g")


def test_extended_points() -> None:
    desk = Desk(axes=8, extended_io=True)
    assert desk.ask("OP 65535,65535,65535,65535") == ":"
    assert [desk.number(f"_OP{bank}") for bank in range(4)] == [65535, 0x7F7F, 0x7F7F, 0x7F7F]
    desk.unit.set_input(64, level=False)
    assert desk.ask("TI7") == " 127\r\n:"


def test_latch_inputs_of_the_upper_axes() -> None:
    desk = Desk(axes=8)
    desk.ask("PRE=5000", "BGE")
    desk.rest()
    desk.ask("ALE")
    assert desk.number("_ALE") == 1
    desk.unit.set_input(9, level=False)
    assert (desk.number("_ALE"), desk.number("_RLE")) == (0, 5000)


def test_stepper_motors_need_jumpers_and_home_in_two_stages() -> None:
    desk = Desk(stepper_jumpers=False)
    assert desk.ask("MT 2") == "?"
    assert desk.code() == 96
    desk = Desk(home_edge={"X": 5000}, index_every={"X": 4000})
    desk.ask("MT 2", "SP 20000", "HMX", "BGX")
    desk.rest()
    assert desk.unit.position("X") == pytest.approx(5000, abs=1)
    assert desk.ask("SP 2000002") == "?"


def test_absolute_encoders() -> None:
    desk = Desk(absolute_encoders={"X": 50000})
    assert desk.ask("AEX=4096") == "?"
    assert desk.code() == 115
    assert desk.ask("MO", "AEX=4096") == ":"
    assert desk.ask("TPX") == desk.ask("TYX") == " 0000050000\r\n:"
    assert desk.ask("QY") == "P+00012\r\n:"
    desk.ask("AEY=4096")
    assert desk.code() == 117


def test_burned_state_and_the_three_resets() -> None:
    desk = Desk()
    desk.ask("SP 777", "CC 9600,1,0,1", "BN", "DL\r#AUTO;SB3;EN\r\\", "BP", "SP 5", "RS1")
    assert desk.ask("SP?") == " 0000000776\r\n:"
    desk.ask("RS2")
    assert desk.ask("LL") == ":"
    desk.ask("RS")
    assert desk.unit.output_level(3)
    desk.ask("\x12\x13")
    assert desk.ask("TPX").startswith("TPX\r")
    assert desk.ask("EO 0", "SP?") == " 0000025000\r\n:"


def test_a_locked_controller_may_be_queried_and_stopped() -> None:
    desk = Desk()
    desk.ask("JG 1000", "BGX", "LC 00000000,1")
    assert [desk.ask(command) for command in ("PR ,5", "BN", "LS", "DL")] == [":", "?", "?", "?"]
    desk.ask("LC 00000000,2")
    assert [desk.ask(command) for command in ("PR ,6", "V=1", "PR ,?", "ST")] == ["?", "?", " 0000000005\r\n:", ":"]
    assert desk.ask("LC 00000000,0", "PW KEY,KEY", "LC KEY,1", "LC ?") == " 00000001\r\n:"


# Port 2


def test_an_operators_panel_on_port_two() -> None:
    desk = Desk()
    panel: list[bytes] = []
    second = desk.unit.connect("serial2", panel.append, lambda: None)
    desk.ask(
        "CC 9600,0,0,1",
        'DL\r#A;CI 0,1\rIN{P2}"LEN ",LEN\rMG{P2}"GOT",LEN{F3.0}\r#L;WT 5;JP #L\r#COMINT;SB1;K=P2NM;EN 1,1\r\\',
        "XQ",
    )
    second.receive_bytes(b"12\r")
    desk.wait(0.1)
    assert b"".join(panel) == b"LEN 12\rGOT 012\r\n"
    assert not desk.unit.output_level(1)
    second.receive_bytes(b"45\r")
    desk.wait(0.1)
    assert desk.unit.output_level(1)
    assert (desk.number("K"), desk.number("P2CD"), desk.number("_HX0")) == (45, 0, 2)
    with pytest.raises(PortRefused):
        desk.open("serial2")


def test_operator_data_on_port_one_is_no_command() -> None:
    desk = Desk()
    desk.ask("DL\r#A;CI ,,1\r#L;WT 5;JP #L\r\\", "XQ")
    assert desk.ask("STOP") == ""
    desk.line.receive_bytes(b"\\")
    assert desk.ask("MG P1ST{S4}") == "STOP\r\n:"
    assert desk.number("P1CD") == -1


# Chain


def test_a_chain_takes_commands_by_address() -> None:
    desk = Desk(chain=PAIR)
    assert desk.ask("TP", wait_s=0.1) == ""
    assert desk.ask("%0", "TP", wait_s=0.1).count(",") == 3
    assert desk.ask("%1", wait_s=0.1) == ":"
    assert desk.ask("TP", wait_s=0.1).count(",") == 1
    assert desk.ask("TB", wait_s=0.1) == " 128\r\n:"
    assert desk.ask("%5", "TP", wait_s=0.1) == ""
    assert desk.ask("%0", wait_s=0.1) == ":"


def test_a_broadcast_is_received_by_all_and_answered_by_address_zero() -> None:
    desk = Desk(chain=PAIR, echo=True)
    desk.ask("%1", "PR 700,1500", wait_s=0.1)
    assert desk.ask("!BG", wait_s=0.1) == "!BG\r:"
    desk.rest()
    assert [desk.unit.position(axis) for axis in ("0X", "1X", "1Y")] == [0, 700, 1500]
    assert desk.ask("!MG _BGY{F1.0}", wait_s=0.1) == "!MG _BGY{F1.0}\r 0\r\n:"
    assert desk.ask("!XX", wait_s=0.1) == "!XX\r?"
    assert desk.ask("TC0", wait_s=0.1) == "TC0\r 001\r\n:"


def test_a_refused_broadcast_of_another_address_is_silent() -> None:
    desk = Desk(chain=PAIR)
    desk.ask("%1", "MO", wait_s=0.1)
    assert desk.ask("!BG", wait_s=0.1) == ":"
    assert desk.ask("TC0", wait_s=0.1) == " 020\r\n:"


def test_each_controller_of_the_chain_costs_a_hop() -> None:
    desk = Desk(chain=[{"address": number, "axes": 1} for number in range(8)])
    desk.ask("!PR 1000", "!BG", wait_s=0.1)
    starts = [motion.start_ns for motion in desk.unit.commanded_motions]
    assert [motion.axis for motion in desk.unit.commanded_motions] == [f"{number}X" for number in range(8)]
    assert starts[-1] - starts[0] == pytest.approx(7 * HOP_NS, abs=SAMPLE_NS)
    desk.ask("%7", wait_s=0.1)
    desk.heard, asked_ns = b"", desk.clock.now_ns()
    desk.line.receive_bytes(b"MG 1\r")
    while not desk.heard:
        desk.clock.make_next_call()
    assert desk.clock.now_ns() - asked_ns == 14 * HOP_NS


def test_a_chain_ends_where_a_controller_is_off_or_its_second_port_is_general() -> None:
    desk = Desk(chain=PAIR)
    desk.ask("%0", "CC ,,0", wait_s=0.1)
    assert desk.ask("%1", wait_s=0.1) == ""
    assert desk.ask("%0", "CC 19200,,1", "%1", wait_s=0.1) == ":"
    desk.chain.units[1].set_power(on=False)
    assert desk.ask("TP", wait_s=0.1) == ""
    desk.chain.units[1].set_power(on=True)
    assert desk.ask("%1", wait_s=0.1) == ":"
    desk.chain.units[0].set_power(on=False)
    assert desk.hung_up


def test_points_of_a_chain_are_numbered_by_address() -> None:
    desk = Desk(chain=PAIR)
    seen: list[tuple[int, bool]] = []
    desk.unit.on_output(lambda number, level: seen.append((number, level)))
    desk.ask("%1", "SB 2", wait_s=0.1)
    assert seen == [(102, True)]
    assert desk.unit.output_level(102)
    desk.unit.set_input(103, level=False)
    assert desk.ask("MG @IN[3]{F1.0}", wait_s=0.1) == " 0\r\n:"
    desk.unit.set_limit("1Y", "forward")
    assert desk.ask("MG _LFY{F1.0}", wait_s=0.1) == " 0\r\n:"


# Sample clock


def _clocked(external: bool) -> list[dict[str, object]]:
    return [
        {"address": 0, "axes": 1, "drift_ppm": 80.0},
        {"address": 1, "axes": 1, "drift_ppm": -80.0, "external_clock": external},
    ]


def test_a_wired_sample_clock_keeps_controllers_in_step() -> None:
    starts: dict[bool, list[int]] = {}
    for external in (True, False):
        desk = Desk(chain=_clocked(external), shared_clock=True, hop_ns=0)
        desk.wait(100.0)
        before = [desk.ask("%0", "MG TIME{F10.0}"), desk.ask("%1", "MG TIME{F10.0}")]
        desk.ask("!PR 100000", "!BG")
        desk.rest()
        starts[external] = [motion.start_ns for motion in desk.unit.commanded_motions]
        ends = {motion.end_ns for motion in desk.unit.commanded_motions}
        assert (len(set(before)) == 1) is external
        assert (len(ends) == 1) is external
    assert len(set(starts[True])) == 1


def test_without_a_wire_an_external_clock_never_ticks() -> None:
    desk = Desk()
    desk.ask("TM -1000", "PR 1000", "BGX")
    before = desk.number("TIME")
    desk.wait(5.0)
    assert (desk.number("TIME"), desk.number("_BGX"), desk.number("_RPX")) == (before, 1, 0)
    assert desk.ask("TM ?") == "-01000\r\n:"
    desk.ask("TM 1000")
    desk.rest()
    (motion,) = desk.unit.commanded_motions
    assert (motion.end_counts, desk.unit.position("X")) == (1000, 1000)
    assert motion.start_ns == pytest.approx(5e9, abs=2 * SAMPLE_NS)


def test_a_source_that_is_off_stops_the_others_and_one_that_changes_its_rate_changes_theirs() -> None:
    desk = Desk(chain=_clocked(True), shared_clock=True)
    desk.ask("%1", "JG 10000", "BG", wait_s=1.0)
    assert desk.unit.velocity("1X") == pytest.approx(10000, rel=1e-3)
    desk.ask("%0", "TM 2000", wait_s=0.1)
    assert desk.unit.velocity("1X") == pytest.approx(5000, rel=1e-3)
    desk.chain.units[0].set_power(on=False)
    place = desk.unit.position("1X")
    desk.wait(1.0)
    assert desk.unit.position("1X") == place
    desk.chain.units[0].set_power(on=True)
    desk.wait(1.0)
    assert desk.unit.position("1X") > place + 9000


# Whole


def test_a_stop_lets_the_contours_record_end() -> None:
    desk = Desk()
    desk.ask("CM X", "DT 8", "CD 1000", "CD 500")
    desk.wait(0.1)
    desk.ask("STX")
    desk.rest()
    assert desk.unit.position("X") == 1000
    assert (desk.number("_SCX"), desk.ask("CD 5")) == (51, "?")


def test_an_idle_controller_schedules_nothing_and_power_off_drops_the_port() -> None:
    desk = Desk()
    desk.ask("PR 100", "BGX")
    desk.rest()
    assert desk.clock.next_ns() is None
    desk.unit.set_power(on=False)
    assert desk.hung_up
    with pytest.raises(PortRefused):
        desk.open("serial")
    desk.unit.set_power(on=True)
    desk.line = desk.open("serial")
    assert desk.number("TIME") == 0


def test_threads_take_turns_command_by_command() -> None:
    desk = Desk(timing=FirmwareTiming(decode_ns=500_000))
    desk.ask("A=0;B=0", "DL\r#A;A=A+1;JP#A\r#B;B=B+1;B=B+1;B=B+1;JP#B\r\\", "XQ#A,0;XQ#B,1", wait_s=0.05)
    desk.wait(6.0)
    desk.ask("HX", wait_s=0.05)
    assert desk.number("B", wait_s=0.01) / desk.number("A", wait_s=0.01) == pytest.approx(1.5, rel=0.02)


@pytest.mark.parametrize(
    "options", [{"axes": 3}, {"address": 8}, {"colour": "red"}, {"chain": []}, {"chain": [{"address": 1}] * 2}]
)
def test_a_wrong_option_is_named(options: dict[str, object]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        SMC2000.build_controller(EventQueue(), options)


def test_no_input_crashes_it() -> None:
    chance = random.Random(11)
    words = [*'[](){},;#?"XYH*=<>\\%!', "BG", "ST", "PR=", "JG", "VM", "LI", "CR", "VP", "CD", "CM", "DT", "QD", "DL"]
    words += ["XQ", "MG", "CC", "CI", "TM", "_TP", "@SIN", "EG", "GA", "1", "-9", ".5", "{P2}", "{S}", "P2ST"]
    desk = Desk(axes=8, extended_io=True)
    for _ in range(1500):
        if chance.random() < 0.2:
            data = chance.randbytes(chance.randrange(1, 40))
        else:
            data = "".join(chance.choice(words) for _ in range(chance.randrange(1, 8))).encode() + b"\r"
        desk.line.receive_bytes(data)
        desk.wait(0.002)
    desk.line.receive_bytes(b"\x1a\x1a\r")
    desk.unit.set_power(on=False)
    desk.unit.set_power(on=True)
    desk.line = desk.open("serial")
    assert desk.number("1") == 1


def test_a_cam_slave_may_wait_for_both_ends_at_once() -> None:
    desk = Desk(axes=2)
    desk.ask("EAX", "EM 2000,1000", "EP 1000,0", "ET[0]=,0", "ET[1]=,500", "ET[2]=,1000", "EB1", "PA ,500", "BGY")
    desk.rest()
    desk.ask("JG 1000", "BGX", "EG ,1000", "EQ ,1000")
    assert desk.number("_EQY") == 3
    desk.wait(1.5)
    assert (desk.number("_EQY"), desk.number("_EGY")) == (2, 1)
    desk.wait(2.0)
    assert (desk.number("_EQY"), desk.number("_EGY")) == (0, 0)
    assert desk.unit.position("Y") == pytest.approx(500, abs=2)
