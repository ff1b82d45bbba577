"""Simulated SMC30 as separate controllers on one serial line."""

from collections.abc import Mapping, Sequence

import pytest

from orchestrator.clock.queue import EventQueue
from sim.core.controller import DeviceSpec, FirmwareTiming, build_line
from sim.core.oscillator import Oscillator
from sim.smc30 import SMC30
from sim.smc30.framing import compute_checksum

MS = 1_000_000


class Line:
    """Controllers with these addresses on a line, and all bytes that have arrived from it."""

    def __init__(self, addresses: Sequence[int], options: Mapping[str, object] | None = None) -> None:
        self.clock = EventQueue()
        names = [f"u{place}" for place in range(len(addresses))]
        branches = {
            name: DeviceSpec(address, options or {}, Oscillator(), FirmwareTiming(decode_ns=MS), seed=3)
            for name, address in zip(names, addresses, strict=True)
        }
        line = build_line(SMC30, self.clock, branches)
        self.units = [line.devices[name] for name in names]
        self.said = b""
        self.port = line.endpoint.connect("serial", self._heard, lambda: None)

    def _heard(self, data: bytes) -> None:
        self.said += data

    def ask(self, text: bytes, wait_ms: float = 20.0) -> bytes:
        """The bytes that arrive within `wait_ms` of a line."""
        before = len(self.said)
        self.port.receive_bytes(text)
        self.wait(wait_ms)
        return self.said[before:]

    def wait(self, ms: float) -> None:
        self.clock.run_until_ns(self.clock.now_ns() + round(ms * MS))


def test_only_the_controller_with_the_address_answers() -> None:
    line = Line([2, 5])
    assert line.ask(b"5f+70\r") == b"Y\r"
    assert line.ask(b"2V1\r") == b"V+0\r"
    assert line.ask(b"5V1\r") == b"V+70\r"
    assert line.ask(b"3V1\r") == b""
    assert line.ask(b"V1\r") == b""
    assert [unit.position("1") for unit in line.units] == [0.0, 70.0]


def test_the_checksum_is_one_character_even_if_that_is_a_return() -> None:
    line = Line([3], {"checksum": True})
    text = b"3Z"
    assert compute_checksum(text) == 13
    assert line.ask(text + b"\r\r") == b"YY\r"
    assert line.ask(b"3F\x00\r") == b"E1v\r"


def test_simultaneous_replies_of_two_controllers_garble_each_other() -> None:
    line = Line([1, 2])
    assert line.ask(b"1V1\r2TP\r") not in (b"V+0\rTP25\r", b"TP25\rV+0\r")
    assert line.ask(b"1V1\r") + line.ask(b"2TP\r") == b"V+0\rTP25\r"


def test_two_controllers_with_one_address_both_answer() -> None:
    line = Line([4, 4])
    line.units[0].set_input(1, level=True)
    line.wait(1)
    assert len(line.ask(b"4V2\r")) == 2 * len(b"V00\r")


def test_a_controller_that_is_off_sends_nothing_and_the_others_continue() -> None:
    line = Line([1, 2])
    line.units[0].set_power(on=False)
    assert line.ask(b"1F\r") == b""
    assert line.ask(b"2F\r") == b"R\r"
    line.units[0].set_power(on=True)
    line.wait(10)
    assert line.ask(b"1F\r") == b"R\r"


def test_inputs_and_outputs_belong_to_each_controller() -> None:
    line = Line([1, 2])
    heard: list[tuple[int, bool]] = []
    line.units[1].on_output(lambda number, level: heard.append((number, level)))
    assert line.ask(b"2A3\r") == b"Y\r"
    assert heard == [(3, True)]
    assert line.units[1].output_level(3)
    assert not line.units[0].output_level(3)
    with pytest.raises(ValueError, match="input 5"):
        line.units[0].set_input(5, level=True)


def test_motions_belong_to_each_controller() -> None:
    line = Line([1, 2])
    line.ask(b"2+10\r", 200)
    assert [len(unit.commanded_motions) for unit in line.units] == [0, 1]
    assert line.units[1].commanded_motions[0].axis == "1"
    assert line.units[1].commanded_motions[0].end_counts == 10.0


def test_an_input_is_seen_at_the_next_look_of_the_firmware() -> None:
    begun: list[float] = []
    for seed in range(20):
        clock = EventQueue()
        branch = DeviceSpec(1, {"input_poll_ms": 1.0, "input_filter_ms": 0.1}, Oscillator(), FirmwareTiming(), seed)
        line = build_line(SMC30, clock, {"u": branch})
        port = line.endpoint.connect("serial", lambda _: None, lambda: None)
        for text in (b"1PO\r", b"1N11.19\r", b"1+10\r", b"1E\r"):
            port.receive_bytes(text)
        clock.run_until_ns(50 * MS)
        line.devices["u"].set_input(1, level=True)
        clock.run_until_ns(500 * MS)
        begun.append(line.devices["u"].commanded_motions[0].start_ns / MS - 50)
    # The filter, up to one look, and the latency of 1 ms.
    assert 1.1 <= min(begun) < 1.4
    assert 1.8 < max(begun) <= 2.1


def test_controllers_of_one_line_must_agree_about_its_settings() -> None:
    branches = {
        name: DeviceSpec(place, {"baud": baud}, Oscillator(), FirmwareTiming(), 0)
        for place, (name, baud) in enumerate((("a", 9600), ("b", 4800)), start=1)
    }
    with pytest.raises(ValueError, match="baud"):
        build_line(SMC30, EventQueue(), branches)
    with pytest.raises(ValueError, match="speed"):
        build_line(SMC30, EventQueue(), {"a": DeviceSpec(1, {"speed": 1}, Oscillator(), FirmwareTiming(), 0)})
