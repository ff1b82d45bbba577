"""The simulated SHRC-203 in virtual time: behaviour that the test vectors do not cover."""

from collections.abc import Mapping

import pytest

from orchestrator.clock.queue import EventQueue
from sim.core.controller import FirmwareTiming, PortRefused
from sim.core.oscillator import Oscillator
from sim.shrc203 import SHRC203

MS = 1_000_000
S = 1_000_000_000


class Rig:
    """A controller on a clock of its own, and every line it has sent with its instant."""

    def __init__(
        self,
        options: Mapping[str, object] | None = None,
        oscillator: Oscillator | None = None,
        timing: FirmwareTiming | None = None,
        seed: int = 0,
    ) -> None:
        self.clock = EventQueue()
        self.unit = SHRC203.build_controller(self.clock, options or {}, oscillator=oscillator, timing=timing, seed=seed)
        self.said: list[tuple[int, str]] = []
        self.port = self.unit.connect("serial", self._heard, lambda: None)

    def _heard(self, data: bytes) -> None:
        self.said += [(self.clock.now_ns(), line) for line in data.decode("latin-1").split("\r\n")[:-1]]

    def ask(self, text: str) -> str:
        """The line that answers `text` at once."""
        before = len(self.said)
        self.port.receive_bytes(text.encode("latin-1") + b"\r\n")
        assert len(self.said) > before, f"no answer to {text}"
        return self.said[before][1]

    def ok(self, *texts: str) -> None:
        for text in texts:
            assert self.ask(text) == "OK", text

    def wait(self, seconds: float) -> list[str]:
        """Let time pass; return the lines that arrive meanwhile."""
        before = len(self.said)
        self.clock.run_until_ns(self.clock.now_ns() + round(seconds * S))
        return [line for _, line in self.said[before:]]

    def coordinates(self) -> list[int]:
        return [int(field.replace(" ", "")) for field in self.ask("Q:").split(",")[:3]]


def test_prebuffer_migrates_before_the_completion_character() -> None:
    seen: list[str] = []

    def on_line(data: bytes) -> None:
        if data == b"1\r\n" and "1" not in seen:
            seen.append("1")
            other.receive_bytes(b"?:MP1\r\n?:M1\r\n!:\r\n")
        elif data != b"OK\r\n":
            seen.append(data.decode().strip())

    rig = Rig()
    other = rig.unit.connect("serial", on_line, lambda: None)
    other.receive_bytes(b"MP:1+P1000,S100F1000R50\r\nG:1\r\nMP:1+P500,S500F500R1\r\n")
    rig.wait(1.046)
    assert seen == ["OK_D", "1", "NS", "500", "B"]
    rig.wait(2)
    assert seen[-1] == "1"
    first, second = rig.unit.commanded_motions
    assert (first.start_ns, first.end_ns) == (0, 1045 * MS)
    assert (second.start_ns, second.end_ns, second.end_counts) == (1046 * MS, 2046 * MS, 1500.0)


def test_overwriting_is_silent_and_so_is_underrun() -> None:
    rig = Rig({"handover_ms": 0})
    rig.ok("MP:1+P1000,S1000F1000R1", "G:1")
    assert rig.ask("MP:1+P700") == "OK_D"
    assert rig.ask("MP:1+P200") == "OK_D"
    assert rig.wait(5) == ["1", "1"]
    assert rig.coordinates() == [1200, 0, 0]
    assert rig.ask("MP:1+P5") == "OK"
    assert rig.wait(5) == []
    assert rig.coordinates()[0] == 1200


def test_timed_standby_starts_the_move_after_it_and_cancelling_starts_it_early() -> None:
    for command, start_ns in ((None, 500 * MS), ("WT:1,0", 200 * MS), ("WT:1,C", 200 * MS)):
        rig = Rig()
        rig.ok("WT:1,5", "G:1")
        assert rig.ask("MP:1+P100") == "OK_D"
        assert rig.ask("?:WT1") == "NS"
        rig.wait(0.2)
        if command is not None:
            rig.ok(command)
        assert rig.wait(3) == ["1"]
        assert [motion.start_ns for motion in rig.unit.commanded_motions] == [start_ns]


def test_input_standby_compares_all_six_inputs_at_its_own_scan() -> None:
    rig = Rig(seed=7)
    rig.ok("WI:A,1,1", "G:A")
    assert rig.ask("MP:A+P100-P100") == "OK_D"
    idle_at = rig.clock.next_ns()
    assert idle_at is None, "a standby waits without polling"
    rig.wait(0.5)
    rig.unit.set_input(2, level=True)
    rig.unit.set_input(1, level=True)
    rig.wait(0.1)
    assert not rig.unit.commanded_motions
    rig.unit.set_input(2, level=False)
    released_ns = rig.clock.now_ns()
    assert rig.wait(3) == ["1", "2"]
    starts = {motion.start_ns for motion in rig.unit.commanded_motions}
    assert len(starts) == 1
    assert 0 < starts.pop() - released_ns < MS


def test_a_pulse_shorter_than_the_scan_is_not_seen() -> None:
    rig = Rig(seed=7)
    rig.ok("WI:1,1", "G:1")
    rig.wait(0.0001)
    rig.unit.set_input(1, level=True)
    rig.unit.set_input(1, level=False)
    rig.wait(1)
    assert rig.ask("!:") == "B"


def test_stop_discards_the_chain_and_ends_with_the_slope_of_the_ramps() -> None:
    rig = Rig()
    rig.ok("MP:1+P100000,S100F1000R100", "G:1")
    assert rig.ask("MP:1+P100000") == "OK_D"
    rig.wait(1)
    rig.ok("L:1")
    assert rig.wait(1) == ["1"]
    (motion,) = rig.unit.commanded_motions
    assert motion.end_ns == 1100 * MS
    assert rig.coordinates()[0] == motion.end_counts == 1000 - 45 + 55
    assert rig.ask("?:MP1") == "NS"
    assert rig.ask("G:1") == "NG"


def test_surviving_prebuffer_waits_for_the_next_start() -> None:
    rig = Rig({"stop_keeps_prebuffer": True, "completion_after_stop": False})
    rig.ok("MP:1+P100000", "G:1")
    assert rig.ask("MP:1+P50") == "OK_D"
    rig.wait(1)
    rig.ok("L:W")
    assert rig.wait(5) == []
    stopped_at = rig.coordinates()[0]
    assert rig.ask("?:MP1") == "50"
    rig.ok("G:1")
    assert rig.wait(5) == ["1"]
    assert rig.coordinates()[0] == stopped_at + 50


def test_stopping_a_standby_does_not_start_the_move_after_it() -> None:
    rig = Rig()
    rig.ok("WI:1,63", "G:1")
    assert rig.ask("MP:1+P50") == "OK_D"
    rig.ok("L:1")
    assert rig.ask("!:") == "R"
    assert rig.wait(5) == []
    assert not rig.unit.commanded_motions


def test_emergency_stop_and_recovery() -> None:
    rig = Rig()
    rig.ok("MP:A+P100000+P100000", "G:A")
    rig.wait(1)
    rig.ok("L:E")
    assert rig.unit.at_rest()
    assert rig.unit.velocity("1") == 0.0
    assert rig.ask("SRQ:") == "K,R,R"
    assert rig.ask("SRQ:S") == "20,20,20,R,R,R"
    assert rig.ask("M:1+P10") == "NG"
    assert rig.wait(5) == [], "no completion characters after an emergency stop"
    rig.ok("BEC:W")
    assert rig.ask("M:1+P10") == "NG", "the excitation has gone off"
    rig.ok("C:W1", "M:1+P10", "G:1")
    rig.wait(1)
    assert rig.ask("SRQ:S") == "1,1,1,R,R,R"


def test_power_cycle_forgets_what_is_volatile() -> None:
    rig = Rig({"speed": [200, 2000, 50]})
    rig.ok("PAV:SET,3", "PIT:SET,3", "D:1S1F1R1", "W:5", "O:63", "MP:1+P100000,S100F1000R100", "G:1")
    changes: list[tuple[int, bool]] = []
    rig.unit.on_output(lambda number, level: changes.append((number, level)))
    rig.wait(0.5)
    rig.port.receive_bytes(b"?:N")
    rig.unit.set_power(on=False)
    stopped = rig.unit.commanded_motions[0]
    assert stopped.end_ns == 500 * MS
    assert changes == [(number, False) for number in range(1, 7)]
    rig.port.receive_bytes(b"Q:\r\n")
    assert rig.wait(1) == []
    rig.unit.set_power(on=True)
    assert rig.ask("Q:") == "+        0,+        0,+        0,K,K,R"
    assert [rig.ask(item) for item in ("?:D1", "?:W", "?:O", "?:M1", "?:MP1")] == ["S200F2000R50", "0", "0", "NS", "NS"]
    assert rig.ask("PIT:GET,3") == "NG"
    assert rig.ask("PAV:GET,3") == "0,0,0"


def test_reset_is_silent_for_a_while() -> None:
    rig = Rig()
    rig.ok("M:1+P100", "RESET:")
    rig.port.receive_bytes(b"?:N\r\n")
    assert rig.wait(3.1) == []
    assert rig.ask("?:M1") == "NS"


@pytest.mark.parametrize(
    ("line", "reply"),
    [
        (b"\x00\r\n", "NG_I"),
        (b"Q:\x80\r\n", "NG_I"),
        (b"x" * 5000 + b"\r\n", "NG"),
        (b"x" * 5000 + b"\xff\r\n", "NG_I"),
        (b"\x1b[A\r\n", "NG"),
        (b"HELLO\r\n", "NG"),
        (b":\r\n", "NG"),
        (b"M:\r\n", "NG"),
        (b"M:1+P\r\n", "NG"),
        (b"M:1+P1000000000\r\n", "NG"),
        (b"M:1+P99999999999999999999999999999999\r\n", "NG"),
        (b"M:1+M0.0000000000000000000000000000001\r\n", "NG"),
        (b"M:1P100\r\n", "NG"),
        (b"M:A+P100\r\n", "NG"),
        (b"M:1+P1.5\r\n", "NG"),
        (b"M:1+D1\r\n", "NG"),
        (b"K:W+P1+P1+P1\r\n", "NG"),
        (b"E:3B0N1+P0+P10+P1\r\n", "NG"),
        (b"E:0A0N1+P0+P10\r\n", "NG"),
        (b"D:1S200F100R10\r\n", "NG"),
        (b"S:1,7\r\n", "NG"),
        (b"F:10\r\n", "NG"),
        (b"T:E1P+5\r\n", "NG"),
        (b"T:E1P5\r\n", "NG"),
        (b"H5:1\r\n", "NG"),
        (b"PIT:GET,1\r\n", "NG"),
        (b"PIT:SET,21\r\n", "NG"),
        (b"?:XYZ\r\n", "NG"),
        (b"?:M1,F\r\n", "NG"),
        (b"G\r\n", "NG"),
        (b"G:\r\n", "NG"),
        (b"P:S\r\n", "NG"),
        (b"MS:GET,0,0\r\n", "NG"),
        (b"W:2551\r\n", "NG"),
        (b"WT:1,2551\r\n", "NG"),
        (b"WI:1,64\r\n", "NG"),
        (b"q:su\n", "U0,U0,U0,1,1,1,R,R,R"),
        (b" ! : S \n", "R,R,R"),
    ],
)
def test_bad_input_is_answered_as_documented(line: bytes, reply: str) -> None:
    rig = Rig()
    rig.port.receive_bytes(line[:1])
    assert not rig.said, "half a line waits"
    rig.wait(10)
    rig.port.receive_bytes(line[1:])
    assert [text for _, text in rig.said] == [reply]
    assert rig.ask("?:N") == "SHRC-203"


def test_a_refused_setting_shows_until_the_next_accepted_one() -> None:
    rig = Rig()
    assert rig.ask("M:2+P") == "NG"
    assert rig.ask("SRQ:") == "X,K,R"
    assert rig.ask("SRQ:S") == "1,2,1,R,R,R"
    assert rig.ask("?:XYZ") == "NG"
    rig.ok("W:0")
    assert rig.ask("SRQ:") == "K,K,R"


def test_a_drifting_crystal_stretches_motions_exactly() -> None:
    rig = Rig(oscillator=Oscillator(offset_ns=123_456_789, drift_ppm=-200.0))
    rig.ok("MP:1+P10000,S2F5714R250", "G:1")
    rig.wait(1)
    assert rig.unit.velocity("1") == pytest.approx(5714 * (1 - 200e-6), rel=1e-9)
    rig.wait(4)
    (motion,) = rig.unit.commanded_motions
    assert motion.end_ns is not None
    duration = 10000 / 5714 + 0.25 * (1 - 2 / 5714)
    assert (motion.end_ns - motion.start_ns) / S == pytest.approx(duration / (1 - 200e-6), abs=2e-9)


def test_wandering_crystal_and_far_ends() -> None:
    rig = Rig(oscillator=Oscillator(drift_ppm=30.0, wander_ppm=0.01, seed=4))
    rig.ok("MP:1+P3000000,S1F1000R100", "G:1")
    assert rig.wait(3001) == ["1"]
    (motion,) = rig.unit.commanded_motions
    assert motion.end_ns is not None
    assert motion.end_ns / S == pytest.approx(3000.0999, rel=40e-6)


def test_firmware_takes_its_time_and_keeps_the_order() -> None:
    rig = Rig(timing=FirmwareTiming(decode_ns=MS, spread_ns=MS), seed=3)
    rig.port.receive_bytes(b"MP:1+P10,S100F100R1\r\nG:1\r\n?:N\r\n")
    assert rig.said == []
    rig.wait(1)
    assert [line for _, line in rig.said] == ["OK", "OK", "SHRC-203", "1"]
    times = [at for at, _ in rig.said]
    assert all(MS <= later - earlier <= 2 * MS for earlier, later in zip([0, *times[:2]], times[:3], strict=True))
    (motion,) = rig.unit.commanded_motions
    assert motion.start_ns == times[1]
    assert motion.end_ns is not None
    assert MS <= times[3] - motion.end_ns <= 2 * MS
    again = Rig(timing=FirmwareTiming(decode_ns=MS, spread_ns=MS), seed=3)
    again.port.receive_bytes(b"MP:1+P10,S100F100R1\r\nG:1\r\n?:N\r\n")
    again.wait(1)
    assert again.said == rig.said


def test_limit_switches_stop_and_let_the_axis_back() -> None:
    rig = Rig({"travel_pls": {"1": [-500, 500]}})
    rig.ok("D:1S1000F1000R1", "M:1+P1000", "G:1")
    rig.wait(2)
    assert rig.coordinates()[0] == 500
    assert rig.ask("SRQ:") == "K,1,R"
    assert rig.ask("SRQ:1S") == "80001,R"
    assert rig.ask("K:A+P1+P1") == "NG"
    rig.ok("M:1+P5", "G:1")
    rig.wait(1)
    assert rig.coordinates()[0] == 500
    rig.ok("M:1-P5", "G:1")
    rig.wait(1)
    assert rig.coordinates()[0] == 495
    assert rig.ask("SRQ:") == "K,K,R"
    rig.ok("J:1-", "G:1")
    rig.wait(0.1)
    rig.unit.set_limit("1", "reverse")
    assert rig.wait(0) == []
    assert rig.ask("!:") == "R"
    rig.unit.set_limit("1", "both")
    assert rig.ask("SRQ:") == "K,R,R"
    assert rig.ask("M:1+P1") == "NG"


def test_software_limit_decelerates_onto_it() -> None:
    rig = Rig({"soft_limit_pls": {"1": [-300, 300]}})
    rig.ok("D:1S100F1000R100", "M:1+P1000", "G:1")
    rig.wait(3)
    assert rig.coordinates()[0] == 300
    assert rig.ask("SRQ:1S") == "200001,R"
    rig.ok("J:1-", "G:1")
    rig.wait(30)
    assert rig.coordinates()[0] == -300
    assert rig.ask("SRQ:1S") == "400001,R"


def test_closed_loop_waits_for_a_stalled_stage_until_bec() -> None:
    rig = Rig({"scales": True, "settle_ms": 50})
    rig.ok("F:10", "MP:1+P100,S100F100R1", "G:1")
    rig.wait(1.04)
    assert rig.ask("SRQ:1S") == "10001,B"
    assert rig.wait(0.02) == ["1"]
    rig.unit.set_stalled("1", stalled=True)
    rig.ok("MP:1+P100", "G:1")
    assert rig.wait(10) == []
    assert rig.ask("Q:SPE").split(",")[0] == "P+100"
    assert rig.ask("SRQ:1S") == "10001,B"
    rig.unit.set_stalled("1", stalled=False)
    assert rig.wait(1) == ["1"]
    rig.unit.set_stalled("1", stalled=True)
    rig.ok("MP:1+P20000,S10000F10000R1", "G:1")
    rig.wait(5)
    assert rig.ask("SRQ:1S") == "8010,R"
    assert rig.coordinates()[0] == 10200
    rig.ok("BEC:1")
    rig.unit.set_stalled("1", stalled=False)
    assert rig.ask("SRQ:1S") == "1,R"


def test_an_interpolation_waits_for_all_its_axes() -> None:
    rig = Rig({"handover_ms": 0})
    rig.ok("MP:A+P100+P300,S100F100R1S100F100R1", "G:A")
    assert rig.ask("KP:A+P30+P40,S50F50R1") == "OK_D"
    assert rig.wait(1.5) == ["1"]
    assert rig.ask("!:S") == "B,B,R"
    assert rig.wait(5) == ["2", "1", "2"]
    lines = [motion for motion in rig.unit.commanded_motions if motion.start_ns == 3 * S]
    assert [(motion.axis, motion.end_ns) for motion in lines] == [("1", 4 * S), ("2", 4 * S)]


def test_program_loops_outputs_continuous_motion_and_trigger_lines() -> None:
    rig = Rig({"speed": [100, 1000, 100]})
    rig.ok("P:R", "P:P2", "P:ON", "P:INIT")
    rig.ok("P:SET,1,F,1,3", "P:SET,2,M,1,0,0,10,0,0,5,1,0,5", "P:SET,3,N,1")
    rig.ok("P:SET,10,CM,1,0,0,1000,0,0,1,1,0,0", "P:SET,11,CM,1,0,0,1000,0,0,2,1,0,0", "P:SET,12,INPUT,1", "P:OFF")
    rig.ok("P:C1", "P:T1", "P:S")
    assert rig.ask("P:S") == "NG"
    assert rig.ask("M:1+P1") == "NG"
    rig.wait(0.03)
    assert rig.ask("?:L").split(",")[1:3] == ["1", "2"]
    assert rig.wait(10) == ["TRIG", "TRIG"]
    assert rig.unit.commanded_motions[-1].end_counts == 2030.0
    assert len(rig.unit.commanded_motions) == 4
    assert rig.ask("?:L").startswith("2,1,12,")
    rig.unit.set_input(1, level=True)
    assert rig.wait(0.1) == ["COMP"]
    assert rig.ask("?:L") == "2,0,13,0,0,0,0,0,0,0,0,0"
    last = rig.unit.commanded_motions[-1]
    assert last.end_ns is not None
    assert (last.end_ns - last.start_ns) / S == pytest.approx(2.09, abs=1e-6)


def test_memory_switches_restart_the_controller_when_required() -> None:
    rig = Rig()
    rig.ok("MS:ON", "MS:SET,5,4,777", "MS:OFF")
    assert rig.ask("?:MODE") == "HOST"
    rig.ok("MS:ON", "MS:SET,0,0,3", "MS:OFF")
    rig.port.receive_bytes(b"?:AXIS\r\n")
    assert rig.wait(4) == []
    assert rig.ask("?:AXIS") == "3"
    assert rig.ask("!:S") == "R,R"
    assert rig.ask("Q:SP") == "P0,P0,0,1,1,0,R,R,D"
    assert rig.ask("M:3+P1") == "NG"


def test_an_idle_controller_schedules_nothing_and_a_moving_one_only_its_end() -> None:
    rig = Rig()
    assert rig.clock.next_ns() is None
    rig.ok("T:T100", "MP:1+P1000,S100F1000R50", "G:1")
    assert rig.clock.make_next_call()
    assert rig.clock.now_ns() == 1045 * MS
    assert rig.clock.next_ns() is None


def test_wrong_options_and_ports_are_refused() -> None:
    clock = EventQueue()
    with pytest.raises(ValueError, match=r"wheels; allowed: .*base_rate"):
        SHRC203.build_controller(clock, {"wheels": 4})
    with pytest.raises(ValueError, match="divide"):
        SHRC203.build_controller(clock, {"divide": 7})
    with pytest.raises(PortRefused):
        Rig().unit.connect("tcp", lambda data: None, lambda: None)
    with pytest.raises(ValueError, match="no axis"):
        Rig().unit.position("X")
    bench = SHRC203.vector_bench(clock, {})
    with pytest.raises(ValueError, match="analog"):
        bench.apply_given({"analog": {"1": 2.0}})


def test_trigger_output_follows_drive_pulses_and_stops_with_its_axis() -> None:
    rig = Rig({"speed": [100, 1000, 100]})
    edges: list[tuple[int, int, bool]] = []
    rig.unit.on_output(lambda number, level: edges.append((rig.clock.now_ns(), number, level)))
    # At constant speed: every ten pulses, the end included, each pulse 10 µs long.
    rig.ok("T:P1P10", "MP:1+P35,S100F100R1", "G:1")
    rig.wait(1)
    assert edges == [
        (at * S // 10 + extra, 7, level) for at in (1, 2, 3) for extra, level in ((0, True), (10_000, False))
    ]
    # Back: the interval counts from the last one, whichever way. While it brakes they come on.
    edges.clear()
    rig.ok("MP:1-P1000,S100F1000R1000", "G:1")
    rig.wait(0.5)
    rig.ok("L:1")
    rig.wait(5)
    displacement = 35 - rig.unit.position("1")
    rises = [at_ns for at_ns, _, level in edges if level]
    assert len(rises) == (displacement - 15) // 10 + 1 and rises[-1] > S + S // 2
    # Halted at once: the next position is not reached, and no pulse comes where it would have been.
    edges.clear()
    rig.ok("MP:1+P1000,S100F100R1", "G:1")
    rig.wait(0.35)
    rig.ok("L:E")
    count = len(edges)
    rig.wait(5)
    assert len(edges) == count > 0
    rig.ok("BEC:W", "C:W1", "T:S", "MP:1+P100,S100F100R1", "G:1")
    rig.wait(2)
    assert len(edges) == count


def test_trigger_output_misses_pulses_above_its_speed_and_runs_in_time_at_rest() -> None:
    rig = Rig()
    rises: list[int] = []
    rig.unit.on_output(lambda number, level: rises.append(rig.clock.now_ns()) if level else None)
    rig.ok("T:P1P100", "MP:1+P10000,S57000F57000R1", "G:1")
    rig.wait(1)
    assert not rises
    rig.ok("T:T5")
    begun_ns = rig.clock.now_ns()
    rig.wait(0.12)
    assert rises == [begun_ns + 50 * MS, begun_ns + 100 * MS]
