"""The simulated SMC in virtual time: the test vectors, and what they do not cover."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from orchestrator.clock.queue import EventQueue
from sim.core.controller import FirmwareTiming, PortRefused
from sim.core.oscillator import Oscillator
from sim.core.vectors import read_vectors, run_vector
from sim.ppsmc import PPSMC

MS = 1_000_000
S = 1_000_000_000
VECTORS = read_vectors(Path(__file__).parents[2] / "contract" / "vectors" / "ppsmc.vectors.jsonl")
IDEAL = {"in_poll_ms": 0.0, "line_gap_ms": 0.0, "start_skew_us": 0.0}
STAGE = ("gnum1:1", "frun1:200", "ffast1:2000", "acc1:10", "dec1:10")


@pytest.mark.parametrize("vector", VECTORS, ids=lambda vector: vector["id"])
def test_vector(vector: Mapping[str, Any]) -> None:
    assert run_vector(PPSMC, vector) == []


class Client:
    """One connection, and every line that has arrived on it."""

    def __init__(self, rig: "Rig", port: str = "tcp") -> None:
        self.rig = rig
        self.lost = False
        self.raw = b""
        self.wire = rig.unit.connect(port, self._heard, self._closed)

    def _heard(self, data: bytes) -> None:
        self.raw += data

    def _closed(self) -> None:
        self.lost = True

    def send(self, *commands: str) -> None:
        for command in commands:
            self.wire.receive_bytes(command.encode("latin-1") + b"\r\n")

    def ask(self, command: str) -> list[str]:
        """The lines that arrive at once."""
        self.raw = b""
        self.send(command)
        return self.raw.decode("latin-1").split("\r\n")[:-1]


class Rig:
    """A controller on a clock of its own, with one client."""

    def __init__(
        self,
        options: Mapping[str, object] | None = None,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> None:
        self.clock = EventQueue()
        given = {**IDEAL, **(options or {})}
        self.unit = PPSMC.build_controller(self.clock, given, oscillator=oscillator, timing=timing, seed=seed)
        self.client = Client(self)
        self.ask = self.client.ask
        self.send = self.client.send

    def wait(self, seconds: float) -> None:
        self.clock.run_until_ns(self.clock.now_ns() + round(seconds * S))

    def settle(self) -> None:
        while not self.unit.at_rest():
            assert self.clock.make_next_call()


def test_options_are_checked() -> None:
    with pytest.raises(ValueError, match="unknown option axis"):
        PPSMC.build_controller(EventQueue(), {"axis": 2})
    with pytest.raises(ValueError, match="no axis 2"):
        PPSMC.build_controller(EventQueue(), {"travel_steps": {"2": (0, 1)}})


def test_greeting_and_several_clients() -> None:
    rig = Rig({"max_clients": 2})
    assert rig.client.raw == b"smc 1.1.165\r\n"
    other = Client(rig)
    with pytest.raises(PortRefused):
        Client(rig)
    other.send("block")
    assert rig.ask("?v") == [] and rig.ask("?s") == ["1:16513;"] and rig.ask("?p") == ["1:0;"]
    rig.send("unlock")
    assert other.ask("?us") == ["0"]
    other.wire.close()
    Client(rig)


BAD = """
#x|?p9|?p1x|?pp|acc1:0|acc1:1001|acc1|acc:1|acc9:1|dcpl1:9|unit1:long|goto1:8388608|goto1:1e3|goto1|move1:--1|fast1
us1.5|echo3|txdel4|tbs1:b1|tbg:all|start:7|load:none|?in|dout255|delay0|1:2.0|1:2.0s500r|in0.1|sync1:x|passwd1:12345678
changeip:1.2.3|date32:01:10|time25:00:00|home1:zz|zero9|?ffast1|gosub|spin1:2000|step1|tbs1|edev1:0.0001
"""


@pytest.mark.parametrize(
    "line", ["", "\xff\x00\x80", "?p1" + " " * 300, "1:" + "9" * 200, *BAD.strip().replace("\n", "|").split("|")]
)
def test_bad_lines_are_silent_and_change_nothing(line: str) -> None:
    rig = Rig()
    before = rig.ask("?conf1")
    assert rig.ask(line) == []
    assert rig.unit.at_rest() and not rig.unit.commanded_motions
    assert rig.ask("?conf1") == before
    if line and not line.startswith("#"):
        rig.send("echo1")
        assert rig.ask(line)[0].startswith("error: ")


def test_half_lines_and_line_ends() -> None:
    rig = Rig()
    rig.client.raw = b""
    rig.client.wire.receive_bytes(b"?p")
    rig.wait(5)
    rig.client.wire.receive_bytes(b"1")
    rig.client.wire.receive_bytes(b"\n")
    assert rig.client.raw == b""
    rig.client.wire.receive_bytes(b"\r\n?s1\r")
    assert rig.client.raw == b"1:0;\r\n1:129;\r\n"


def test_serial_frames() -> None:
    rig = Rig()
    serial = Client(rig, "serial")
    assert serial.raw == b""
    serial.send("txp1", "?us")
    assert serial.raw == b"\x020\x03\r\n"
    assert rig.ask("?us") == ["0"]


def test_second_target_waits_and_wrong_state_is_refused() -> None:
    rig = Rig({"axes": 2})
    rig.send(*STAGE, "move1:1000", "move1:500", "move1:7", "gnum1:5", "pos1:3", "fast2+", "tbg")
    rig.settle()
    assert rig.unit.position("1") == 1500 and rig.unit.position("2") == 0
    assert [motion.end_counts for motion in rig.unit.commanded_motions] == [1000, 1500]
    assert rig.ask("?conf1").count("gnum1:1") == 1


def test_group_starts_together_in_device_time() -> None:
    crystal = Oscillator(drift_ppm=100.0)
    rig = Rig({"axes": 2, "start_skew_us": 10.0}, oscillator=crystal)
    rig.send(*STAGE, "frun2:200", "ffast2:2000", "acc2:10", "dec2:10", "tbc", "tbs1:r4000", "tbs2:a-4000", "tbg")
    assert rig.ask("?tb") == ["1:r4000;2:a-4000;"]
    rig.settle()
    one, two = rig.unit.commanded_motions
    assert 0 < abs(one.start_ns - two.start_ns) <= 10_000
    # 4000 steps with two ramps of 0.18 s.
    took = crystal.device_ns(one.end_ns or 0) - crystal.device_ns(one.start_ns)
    assert took == pytest.approx(2.162 * S, abs=2)


def test_quit_decelerates_and_stops_program_and_queue() -> None:
    rig = Rig()
    rig.send(*STAGE, "move1:100000", "move1:1")
    rig.wait(1)
    rig.send("q1")
    assert rig.unit.velocity("1") == 2000
    rig.wait(0.09)
    assert rig.unit.velocity("1") == pytest.approx(1100)
    rig.settle()
    assert len(rig.unit.commanded_motions) == 1 and rig.unit.commanded_motions[0].end_ns == 1_180_000_000
    rig.send("lin1", "delay600", "nl", "start:*5")
    assert rig.ask("?s1") == ["1:65;"] and rig.ask("?line") == ["1"] and rig.ask("?conf") == []
    rig.send("q")
    assert rig.unit.at_rest() and rig.clock.next_ns() is None


def test_spin_changes_speed_and_direction() -> None:
    rig = Rig({"axes": 2})
    rig.send(*STAGE, "spin1:+")
    rig.wait(1)
    rig.send("spin1:-1000", "spin2:+")
    rig.wait(1)
    assert rig.unit.velocity("1") == -1000 and not rig.unit.is_moving("2")
    rig.send("q")
    rig.settle()
    assert len(rig.unit.commanded_motions) == 1


def test_travel_stops_dead_and_clears_the_reference() -> None:
    rig = Rig({"travel_steps": {"1": (-500, 3000)}})
    rig.send(*STAGE, "home1", "echo1")
    assert rig.ask("?s1") == ["1:131;"]
    rig.send("move1:10000")
    rig.settle()
    assert rig.client.raw.endswith(b"error: axis 1: 1500 limit switch error\r\n")
    assert rig.unit.position("1") == 3000 and rig.ask("?s1") == ["1:137;"]
    assert rig.ask("?err") == ["1:1500 limit switch error"]
    assert rig.ask("?status1") == ["1:1500:limit switch error:3000:0:2:0:0:1:0:0", ""]
    rig.send("move1:1")
    assert len(rig.unit.commanded_motions) == 1
    rig.send("cerr", "move1:-100")
    rig.settle()
    assert rig.unit.position("1") == 2900 and rig.ask("?err1") == ["1:0"]


@pytest.mark.parametrize(
    ("command", "place", "position"),
    [
        ("ref1", -901, 45),
        ("org1-", -901, 45),
        ("home1:hs;jg500;vl100;hr90", -1001, 90),
        ("home1:hs;jg-500", -1000, 45),
        ("home1:jg1000", 1999, 1999),
    ],
)
def test_homing_finds_the_switch(command: str, place: int, position: float) -> None:
    """The place is seen from the counter: mechanical position = counter before the search."""
    rig = Rig({"travel_steps": {"1": (-2000, 2000)}, "org_steps": {"1": (-1000, -902)}})
    rig.send(*STAGE, "hsdm1:1", "bln1:0.5", "rofs1:45", command)
    rig.settle()
    assert rig.unit.position("1") == position
    rig.send("pos1:0")
    rig.send("fast1+")
    rig.settle()
    assert rig.unit.position("1") == pytest.approx(2000 - place)
    assert rig.ask("?err1") == ["1:1500 limit switch error"]


def test_encoder_index_reference() -> None:
    rig = Rig({"encoder": True, "index_steps": {"1": (500, 510)}})
    rig.send(*STAGE, "eref1+")
    rig.settle()
    assert rig.ask("?s1") == ["1:1155;"]
    assert rig.unit.commanded_motions[-1].end_counts == 510


def test_closed_loop_corrects_and_gives_up() -> None:
    rig = Rig({"encoder": True, "encoder_follows": True, "increments_per_step": 0.9})
    rig.send(*STAGE, "eres1:1", "edev1:1", "prt1:200", "mpr1:5", "prst1:0.5", "ecl1:1", "goto1:1000")
    rig.settle()
    assert rig.unit.position("1") == 1000 and rig.ask("?ec1") == ["1:999;"]
    assert len(rig.unit.commanded_motions) == 3 and rig.ask("?s1") == ["1:129;"]
    rig.unit.set_stalled("1", stalled=True)
    rig.send("goto1:0")
    rig.settle()
    assert rig.ask("?s1") == ["1:641;"]


def test_oscillation_schedules_only_its_turns() -> None:
    rig = Rig()
    rig.send(*STAGE, "osc1:100")
    turns = 0
    while turns < 10:
        assert rig.clock.make_next_call()
        turns += 1
        assert abs(rig.unit.position("1")) == 100
    assert rig.ask("?p") == ["1:osc;"] and rig.ask("?s") == ["1:256;"]


def test_program_subroutines_inputs_and_axis_choice() -> None:
    rig = Rig({"axes": 2, "hardware": ["io_port", "counter"], "counter_hz": 1000.0, "in_poll_ms": 10.0})
    program = ["gosub10*3", "nl", "msg:a b,c;", "in;", "in3", "cnt.5", "nl", "in0.1", "2:5s500", "nl", "end"]
    rig.send(*program, "lin10", "1:2s500", "set3", "nl", "ret")
    assert rig.ask("?pgm") == [*program, "lin10", "1:2s500", "set3", "nl", "ret"]
    rig.unit.set_input(3, level=True)
    rig.client.raw = b""
    rig.send("start:")
    rig.wait(1)
    assert rig.client.raw == b"ab!c\r\n8\r\n1\r\n" and rig.unit.position("1") == 6
    assert rig.clock.next_ns() is None and rig.unit.output_level(3) and rig.ask("?s2") == ["2:65;"]
    began_ns = rig.clock.now_ns()
    rig.wait(0.003)
    rig.unit.set_input(0, level=True)
    rig.settle()
    # The wait started when the count was over, 0.512 s after the start.
    assert rig.unit.commanded_motions[-1].start_ns == 1_012 * MS > began_ns
    assert rig.unit.position("2") == 5 and rig.ask("?cnt") == ["500"] and rig.ask("?c") == ["500"]
    rig.send("start2:")
    rig.settle()
    assert rig.unit.position("1") == 6 and rig.unit.position("2") == 10


def test_endless_program_does_not_stop_time() -> None:
    rig = Rig({"hardware": ["io_port"]})
    for jump, start in (("jump1", "start:"), ("res0", "start:*2000000000")):
        rig.send("clr", "lin1", "set0", jump, "nl", start)
        rig.wait(0.002)
        assert not rig.unit.at_rest()
        rig.send("q")
        assert rig.unit.at_rest()


def test_counting_move_reports_at_its_end() -> None:
    rig = Rig({"hardware": ["counter"], "counter_hz": 100.0})
    rig.send("ffast1:200", "movec1:400")
    rig.client.raw = b""
    rig.settle()
    assert rig.client.raw == b"200\r\n"


def test_files_and_com_port() -> None:
    rig = Rig({"encoder": True, "com_replies": {"?MEAS1.5": "12.5 V"}})
    rig.send("pos1:1.5", "fdelete:d.txt", "fwrite1:d.txt*a", "fwrite:d.txt*tab", "fwrite1:D.TXT*p", "fwrite:d.txt*crlf")
    assert rig.ask("fget:d.txt") == ["1\t2"]
    rig.send("cc_open", "cc_write:?MEAS1,5", "cc_read")
    assert rig.ask("?ccb") == ["12.5 V"]


def test_shutdown_saves_positions_for_lpox() -> None:
    rig = Rig()
    rig.send("pos1:123", "alias1:X", "update", "shutdown")
    assert rig.client.lost
    rig.wait(3600)
    with pytest.raises(PortRefused):
        Client(rig)
    rig.unit.set_power(on=False)
    rig.unit.set_power(on=True)
    again = Client(rig)
    assert again.ask("?p1") == ["1:0;"]
    again.send("lpox")
    assert again.ask("?p1") == ["1:123;"] and "alias1:X" in again.ask("?conf1")


def test_power_loss_stops_dead_and_reboot_comes_back() -> None:
    rig = Rig()
    rig.send(*STAGE, "fast1+")
    rig.wait(1)
    rig.unit.set_power(on=False)
    assert rig.client.lost and rig.unit.at_rest() and rig.unit.commanded_motions[0].end_ns == S
    rig.unit.set_power(on=True)
    again = Client(rig)
    again.send("fast1+", "reboot")
    assert again.lost and rig.unit.at_rest()
    with pytest.raises(PortRefused):
        Client(rig)
    rig.wait(5)
    assert Client(rig).ask("?s1") == ["1:129;"]


def test_decoding_takes_its_time_and_keeps_the_order() -> None:
    rig = Rig(timing=FirmwareTiming(decode_ns=5 * MS, spread_ns=15 * MS), seed=3)
    rig.send(*STAGE, "move1:10")
    rig.client.wire.close()
    assert not rig.unit.at_rest()
    rig.settle()
    assert rig.unit.position("1") == 10
    assert 6 * 5 * MS <= rig.unit.commanded_motions[0].start_ns <= 6 * 20 * MS
    again = Rig(timing=FirmwareTiming(decode_ns=5 * MS, spread_ns=15 * MS), seed=3)
    again.send(*STAGE, "move1:10")
    again.settle()
    assert again.unit.commanded_motions == rig.unit.commanded_motions


def test_sleep_holds_back_one_client_only() -> None:
    rig = Rig()
    other = Client(rig)
    rig.send("sleep2.5", "move1:5")
    assert other.ask("?s1") == ["1:129;"]
    other.wire.receive_bytes(b"block\r\n?s1\r\nunblock\r\n")
    assert other.raw.endswith(b"1:16513;\r\n")
    rig.wait(5)
    assert not rig.unit.commanded_motions


def test_later_firmware() -> None:
    rig = Rig({"firmware": "1.2", "axes": 2})
    assert rig.client.raw == b"smc 1.2.1093\r\n"
    rig.send("alias1:X~long name", "home2")
    assert rig.ask("?fn1") == ["fn1:long name"] and rig.ask("?a") == ["2"] and rig.ask("?ffast2") == ["ffast2:1000"]
    assert rig.ask("?s") == ["1:129;2:147;"]
    assert [line.count(":") for line in rig.ask("?status")] == [16, 16, 0]
    rig.send("goto1:1000*s500r500a10d2")
    rig.settle()
    assert rig.unit.commanded_motions[0].end_ns == 2 * S
