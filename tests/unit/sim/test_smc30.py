"""The simulated SMC30 in virtual time: behaviour that the test vectors do not cover."""

from collections.abc import Mapping
from itertools import pairwise
from pathlib import Path
from typing import Any

import pytest

from orchestrator.clock.queue import EventQueue
from sim.core.controller import FirmwareTiming, PortRefused
from sim.core.oscillator import Oscillator
from sim.core.vectors import read_vectors, run_vector
from sim.smc30 import SMC30
from sim.smc30.controller import Smc30Controller, build_controller
from sim.smc30.framing import compute_checksum, odd_parity
from sim.smc30.options import read_options

MS = 1_000_000
S = 1_000_000_000
VECTORS = read_vectors(Path(__file__).parents[2] / "contract/vectors/smc30.vectors.jsonl")


class Rig:
    """Controllers on a clock of their own, and every string they have sent with its instant. ideal: firmware takes
    no time."""

    def __init__(
        self,
        options: Mapping[str, object] | None = None,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        ideal: bool = True,
    ) -> None:
        self.clock = EventQueue()
        read = read_options(options or {}, ideal=ideal)
        self.bus: Smc30Controller = build_controller(self.clock, read, oscillator, timing, 1)
        self.said: list[tuple[int, bytes]] = []
        self.port = self.bus.connect("serial", self._heard, lambda: None)

    def _heard(self, data: bytes) -> None:
        self.said.append((self.clock.now_ns(), data))

    def raw(self, data: bytes) -> bytes:
        """Everything that answers `data` at once."""
        before = len(self.said)
        self.port.receive_bytes(data)
        return b"".join(said for _, said in self.said[before:])

    def ask(self, text: str) -> str:
        """The strings that answer the strings `text` at once, their CRs as blanks."""
        return self.raw(text.replace(" ", "\r").encode("latin-1") + b"\r").decode("latin-1").replace("\r", " ").strip()

    def program(self, lines: str, address: str = "") -> None:
        """Store lines, separated by blanks, and execute them."""
        strings = ["PO", *lines.split(), "E"]
        answer = self.ask(" ".join(address + string for string in strings))
        assert answer.startswith(" ".join("Y" * len(strings))), answer

    def wait(self, seconds: float) -> None:
        self.clock.run_until_ns(self.clock.now_ns() + round(seconds * S))


@pytest.mark.parametrize("vector", VECTORS, ids=[str(vector["id"]) for vector in VECTORS])
def test_vector(vector: Mapping[str, Any]) -> None:
    expect = dict(vector["expect"])
    # The format gives this character for the bytes before it, which are those that are sent.
    if (character := expect.pop("checksum_char", None)) is not None:
        sent = vector["send"].encode("latin-1").removesuffix(b"\r")
        assert chr(compute_checksum(sent[:-1])) == chr(sent[-1]) == character
    assert run_vector(SMC30, {**vector, "expect": expect}) == []


def test_idle_and_waiting_controllers_schedule_nothing() -> None:
    rig = Rig({"units": [{"address": place} for place in range(1, 8)]}, ideal=False)
    assert rig.clock.next_ns() is None
    rig.program("N11.19 +100", address="3")
    rig.wait(1)
    assert rig.ask("3F") == "B"
    assert rig.clock.next_ns() is None
    rig.program("JC0.0", address="4")
    rig.wait(1)
    assert rig.clock.next_ns() is None
    rig.bus.set_input(41, level=True)
    rig.wait(0.01)
    assert rig.ask("4F") == "R"


def test_two_controllers_start_from_one_trigger_each_by_its_own_crystal() -> None:
    units = [{"address": 1}, {"address": 2, "drift_ppm": -50.0}]
    rig = Rig({"units": units}, oscillator=Oscillator(drift_ppm=100.0), ideal=False)
    for address in "12":
        rig.program("S100 T1580 R420 N11.19 +4000", address=address)
    rig.wait(1)
    rig.bus.set_input(11, level=True)
    rig.bus.set_input(21, level=True)
    trigger_ns = rig.clock.now_ns()
    rig.wait(4)
    one, two = rig.bus.commanded_motions
    assert (one.axis, two.axis) == ("1", "2")
    # Filter and start latency of decision 15, by each crystal.
    assert one.start_ns - trigger_ns == pytest.approx(1_160_000 * (1 - 100e-6), abs=2)
    assert two.start_ns - trigger_ns == pytest.approx(1_160_000 * (1 + 50e-6), abs=2)
    for motion, ppm in ((one, 100), (two, -50)):
        assert motion.end_ns is not None
        assert motion.end_ns - motion.start_ns == pytest.approx(3 * S * (1 - ppm * 1e-6), abs=2000)
        assert motion.end_counts == 4000


def test_counter_and_rate_agree_in_closed_form_and_on_the_wire() -> None:
    rig = Rig({"live_verify": True})
    rig.program("S100 T1000 R550 +2000")
    seen: list[float] = []
    for _ in range(58):
        rig.wait(0.05)
        seen.append(rig.bus.position("1"))
        assert rig.ask("V1") == f"V+{int(seen[-1] + 1e-6)}"
    assert all(0 < later - sooner <= 50.0001 for sooner, later in pairwise(seen[:-1]))
    assert seen[-1] == 2000
    rig.program("G+0")
    rig.wait(0.5)
    # RS900 in other words: 100 + 0.5 s * 900.
    assert rig.bus.velocity("1") == pytest.approx(-550)


def test_kill_stops_at_once_and_smooth_stop_with_the_ramp() -> None:
    rig = Rig()
    rig.program("R1000 g-")
    rig.wait(5)
    assert rig.ask("Z F") == "Y B"
    before = rig.bus.position("1")
    rig.wait(3)
    assert rig.ask("F") == "R"
    assert before - rig.bus.position("1") == pytest.approx(1000, abs=1.01)
    assert rig.bus.position("1").is_integer()
    rig.program("g+ A1")
    rig.wait(5)
    assert rig.ask("K F V2") == "Y R V00"
    assert not rig.bus.is_moving("1")
    assert rig.bus.position("1").is_integer()


def test_stop_input_suspends_program_and_motion() -> None:
    rig = Rig()
    rig.program("S2000 T1000 +1000 D100 A1")
    rig.wait(0.4)
    rig.bus.set_input(4, level=True)
    rig.wait(5)
    assert rig.bus.position("1") == 400
    assert rig.ask("F V1") == "B B"
    rig.bus.set_input(4, level=False)
    rig.wait(0.6)
    assert rig.bus.position("1") == 1000
    rig.wait(0.5)
    rig.bus.set_input(4, level=True)
    rig.wait(5)
    rig.bus.set_input(4, level=False)
    rig.wait(0.49)
    assert not rig.bus.output_level(1)
    rig.wait(0.02)
    assert rig.bus.output_level(1)
    assert [motion.end_counts for motion in rig.bus.commanded_motions] == [400, 1000]
    # While it is active, started motions wait, and K discards them.
    rig.bus.set_input(4, level=True)
    assert rig.ask("+10 F K F") == "Y B Y R"
    rig.bus.set_input(4, level=False)
    rig.wait(1)
    assert rig.bus.position("1") == 1000


def test_travel_switches_home_and_bound_the_motor() -> None:
    rig = Rig({"travel_steps": [-300, 500]})
    rig.program("f+77 T16 H- T1000 +10000 A1")
    rig.wait(10)
    assert rig.ask("F V1 V2") == "R V+800 V01"
    assert rig.ask("+1 V1 -5") == "Y V+800 Y"
    rig.wait(1)
    assert rig.ask("V1") == "V+795"


def test_home_on_user_input_three() -> None:
    rig = Rig({"home_input": "input3_low"})
    rig.bus.set_input(3, level=True)
    rig.program("f+77 H- A1")
    rig.wait(1)
    rig.bus.set_input(3, level=False)
    assert rig.ask("F V1 V2") == "R V+0 V01"


def test_overflow_is_reported_until_the_counter_is_set() -> None:
    rig = Rig()
    rig.program("f-8388600 -100 A1")
    rig.wait(1)
    assert rig.ask("F F V1 V2") == "E5 E5 V-8388608 V00"
    rig.program("f+0")
    assert rig.ask("F") == "R"


@pytest.mark.parametrize("line", ["J7", "RET", "JS0", "R1=1/0", "R1=1-2", "R(R1)=1", "R1=INPUT5.2", "D=R9+60000"])
def test_a_program_error_ends_the_program_and_is_reported_once(line: str) -> None:
    rig = Rig()
    rig.program(f"A1 {line} A2")
    rig.wait(1)
    assert rig.ask("F F V2") == "E4 R V01"


def test_permanent_memory_runs_at_power_up() -> None:
    rig = Rig({"rec": True}, ideal=False)
    assert rig.ask("PO R7=7 I6 A1 +10 PX M") == "Y Y Y Y Y Y"
    assert rig.ask("F") == "B"
    rig.wait(2)
    assert rig.said[-1][1] == b"Y\r"
    rig.bus.set_power(on=False)
    assert rig.ask("F") == ""
    rig.bus.set_power(on=True)
    rig.wait(3)
    assert rig.ask("F V1 V2 VR7 Q") == "R V+10 V01 R7=7 R7=7 I6 A1 +10 Y"
    broken = Rig({"e2prom_fault": True})
    assert broken.ask("M X I6 I7 F") == "E6 E6 E6 E6 R"


def test_power_off_stops_the_motor_dead() -> None:
    rig = Rig()
    rig.program("g+")
    rig.wait(1)
    rig.bus.set_power(on=False)
    assert not rig.bus.is_moving("1")
    assert rig.bus.at_rest()
    assert rig.bus.commanded_motions[0].end_ns == S
    assert rig.clock.next_ns() is None
    rig.bus.set_power(on=True)
    rig.wait(0.1)
    assert rig.ask("V1 VT Q") == "V+0 T1000 Y"


def test_bytes_on_the_line_before_power_up_are_not_received() -> None:
    rig = Rig()
    rig.bus.set_power(on=False)
    rig.bus.set_power(on=True)
    assert rig.ask("F") == ""
    rig.wait(0.1)
    assert rig.ask("F") == "R"


def test_checksum_is_a_raw_character() -> None:
    rig = Rig({"checksum": True, "units": [{"address": place} for place in range(1, 8)]})
    for place in range(1, 8):
        for command in ("Z", "K", "V1", "VA", "+100"):
            text = f"{place}{command}".encode()
            reply = rig.raw(text + bytes((compute_checksum(text),)) + b"\r")
            assert reply.endswith(b"\r"), text
            assert reply[-2] == compute_checksum(reply[:-2]), text
    # A checksum that would be CR leaves the string open until something else follows.
    assert rig.raw(b"3Z\r") == b""
    assert rig.raw(b"4K\x7f\r") == b"E1v\rYY\r"
    assert rig.raw(b"3Z") + rig.raw(b"\r") + rig.raw(b"\r") == b"YY\r"


@pytest.mark.parametrize(
    ("sent", "reply"),
    [
        (b"VT\xd4\r", b"E1\r"),
        (b"\xc6\r", b"E1\r"),
        (b"F\x8d", b"E1\r"),
        (b"F" * 81 + b"\r", b"E1\r"),
        (b"F", b""),
        (b"\r\n\r\n", b""),
        (b"\x00\x1b\r", b"E4\r"),
        (b"1F\r", b"E4\r"),
        (b"f\r", b"E4\r"),
        (b"A12\r", b"E2\r"),
        (b"A4\r", b"E4\r"),
        (b"RS9\r", b"E5\r"),
        (b"R3=R23+T-100\r", b"E4\r"),
        (b"F\r\nV1\r\n", b"R\rV+0\r"),
    ],
)
def test_bad_input(sent: bytes, reply: bytes) -> None:
    rig = Rig()
    assert rig.raw(sent) == reply
    rig.raw(b"\r")
    assert rig.ask("F") == "R"


def test_multipoint_silence_and_one_address_twice() -> None:
    rig = Rig({"units": [{"address": 1}, {"address": 2}, {"address": 2}]})
    assert rig.ask("F 3F F1 0F") == ""
    assert rig.raw(b"\xb1F\r") == b""
    assert rig.raw(b"1\xc6\r") == b"E1\r"
    assert rig.ask("1F") == "R"
    assert rig.ask("2A1") == "Y Y"
    assert (rig.bus.output_level(11), rig.bus.output_level(21), rig.bus.output_level(31)) == (False, True, True)
    rig.wait(1)
    rig.bus.set_input(31, level=True)
    assert rig.raw(b"2V2\r") == b"V01\rV01\r"
    rig.wait(1)
    rig.bus.set_unit_power("3", on=False)
    assert rig.raw(b"2V2\r") == b"V01\r"


def test_parity_on_the_wire() -> None:
    rig = Rig({"parity": "wire"})
    assert rig.raw(odd_parity(b"VT\r")) == odd_parity(b"T1000\r")
    assert rig.raw(b"VT\r") == odd_parity(b"E1\r")


def test_busy_answers_and_live_verify() -> None:
    rig = Rig()
    rig.program("W1")
    assert rig.ask("V1 V2 VT A1 E PO F K5") == "B B B B B B B E2"
    assert rig.ask("Z F") == "Y R"
    assert Rig({"power_up_e1": True}).ask("F F") == "E1 R"
    assert Rig({"direct_moves": False}).ask("+10 A1") == "E4 Y"
    small = Rig({"type": "SMC30B"})
    assert small.ask("CS500 CR6000 CT6001") == "Y Y E4"
    assert small.bus.find_indexer("1").motor_parameters.currents_ma == {"CS": 500, "CR": 6000, "CT": 1000}


def test_commands_accepted_in_programming_mode() -> None:
    rig = Rig()
    assert rig.ask("PO F VT V1 V2 M X  Q K A1 V2") == "Y R T1000 E4 E4 E4 E4 Y  Y Y Y V01"


def test_register_programs() -> None:
    rig = Rig({"modules": {5: {2: 300}, 9: {41: 0}}})
    rig.program('R1=INPUT5.2 AO5.7 PRINT9.41.R1 PRINT255.0.R1 L0 R2=R2+n f+2 L=3 IFR2<>6 A1 PRINT255.0."done"')
    assert [said for _, said in rig.said[-2:]] == [b"300\r", b"done\r"]
    modules = rig.bus.find_indexer("1").modules
    assert (modules.flags, modules.shown) == ({(5, 7)}, {(9, 41): "300"})
    assert rig.ask("VR2 V2") == "R2=6 V00"
    # A loop without L0 starts at the first line; 33 subroutines are one too many.
    rig.program("R3=R3+1 L4")
    assert rig.ask("VR3") == "R3=5"
    rig.program("S100 T100 f+0 con=0.5 +1 +1 -3")
    rig.wait(1)
    assert rig.ask("V1") == "V+0"


def test_sweep_of_the_top_rate() -> None:
    rig = Rig()
    rig.program("f+0 T=100 T=T+50 IFT>4000 J7 +1000 J2 A1")
    rig.wait(300)
    assert rig.ask("F V1 V2") == "R V+78000 V01"
    assert len(rig.bus.commanded_motions) == 78


def test_endless_loops_do_not_stop_the_clock() -> None:
    rig = Rig()
    rig.program("A1 C1 J0")
    rig.wait(1)
    assert rig.ask("F K") == "B Y"


def test_a_polling_loop_sleeps_and_keeps_its_phase() -> None:
    rig = Rig(ideal=False)
    # Lines are 1 ms each: E at 0, JC0.0 at 1, 2, 3, … ms; seen 0.16 ms after the wire; A1 one line later.
    rig.program("JC0.0 A1 JC1=1.2")
    changes: list[tuple[int, bool]] = []
    rig.bus.on_output(lambda number, level: changes.append((rig.clock.now_ns(), level)))
    rig.wait(0.0105)
    rig.bus.set_input(1, level=True)
    rig.wait(0.0001)
    assert rig.clock.next_ns() == 10_660_000
    rig.wait(0.02)
    assert changes == [(12 * MS, True)]
    assert rig.clock.next_ns() is None
    rig.bus.set_input(1, level=False)
    rig.wait(0.0021)
    assert rig.ask("F") == "R"


def test_a_pulse_shorter_than_the_filter_is_not_seen() -> None:
    rig = Rig(ideal=False)
    rig.program("W2 A1")
    rig.bus.set_input(2, level=True)
    rig.wait(0.0001)
    rig.bus.set_input(2, level=False)
    rig.wait(0.1)
    assert rig.ask("F") == "B"
    rig.bus.set_input(2, level=True)
    rig.wait(0.01)
    assert rig.ask("F V2") == "R V21"


def test_stop_conditions_of_n_and_na() -> None:
    rig = Rig()
    rig.program("R1000 NAX.A2>100 g+ N11.91 g- A1")
    rig.wait(3)
    rig.bus.set_analog(2, 2.0)
    rig.wait(1.81)
    assert rig.bus.velocity("1") == pytest.approx(100, abs=10)
    rig.wait(0.5)
    # The ramp of 1000 steps is made once more; then the second run goes back until input 1 is high.
    top = rig.bus.commanded_motions[0].end_counts
    assert top is not None
    assert top == pytest.approx(1000 + 1000 * (3 - 2000 / 1100) + 1000, abs=2)
    assert rig.bus.velocity("1") < -100
    rig.bus.set_input(1, level=True)
    rig.wait(1)
    assert rig.ask("F V2") == "R V11"
    assert len(rig.bus.commanded_motions) == 2


def test_decoding_takes_time_and_keeps_order() -> None:
    rig = Rig(timing=FirmwareTiming(decode_ns=2 * MS, spread_ns=MS))
    rig.port.receive_bytes(b"F\rVT\rK5\r")
    assert not rig.said
    assert not rig.bus.at_rest()
    rig.wait(0.1)
    assert [text for _, text in rig.said] == [b"R\r", b"T1000\r", b"E2\r"]
    times = [0, *(at for at, _ in rig.said)]
    assert all(2 * MS <= later - sooner <= 3 * MS for sooner, later in pairwise(times))


def test_an_answer_that_makes_the_other_end_send_at_once() -> None:
    rig = Rig({"units": [{"address": 1}, {"address": 2}]})
    heard: list[bytes] = []

    def answer(data: bytes) -> None:
        heard.append(data)
        if len(heard) == 1:
            port.receive_bytes(b"2VT\r")

    port = rig.bus.connect("serial", answer, lambda: None)
    port.receive_bytes(b"1F\r2VS\r")
    assert heard == [b"R\r", b"S100\r", b"T1000\r"]


def test_wrong_options_and_ports_are_refused() -> None:
    for wrong in ({"speed": 1}, {"address": 8}, {"units": [{"address": 1, "baud": 110}]}, {"travel_steps": [5, 5]}):
        with pytest.raises(ValueError):
            SMC30.build_controller(EventQueue(), wrong)
    with pytest.raises(PortRefused):
        SMC30.build_controller(EventQueue(), {}).connect("tcp", lambda _: None, lambda: None)
