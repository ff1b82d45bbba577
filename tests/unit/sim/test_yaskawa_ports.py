"""What published client programs depend on at the ports of both simulated Yaskawa controllers, where the manuals are
silent or ambiguous: the default follows the field, an option has the other reading."""

import struct
from typing import Any

import pytest

from orchestrator.clock.queue import EventQueue
from sim.yaskawa import SMC2000, SMC4000

MODELS = [(SMC4000, "tcp"), (SMC4000, "serial"), (SMC2000, "serial")]
IDS = ["smc4000-tcp", "smc4000-serial", "smc2000"]
REVISION = {"smc4000": b"SMC4040 Rev 1.0a\r\n:", "smc2000": b"SMC-2000-4 Rev 2.0g\r\n:"}


class Client:
    """A connection without echo."""

    def __init__(self, simulator: Any, port: str, **options: object) -> None:
        self.clock, self._answers = EventQueue(), bytearray()
        self.unit = simulator.build_controller(self.clock, {"echo": False, **options})
        self.line = self.unit.connect(port, self._answers.extend, lambda: None)

    def ask(self, *pieces: bytes) -> bytes:
        self._answers.clear()
        for piece in pieces:
            self.line.receive_bytes(piece)
            self.clock.run_until_ns(self.clock.now_ns() + 1)
        return bytes(self._answers)


@pytest.mark.parametrize("end", [b"", b"\r", b"\r\n", b";"])
@pytest.mark.parametrize("control", [b"\x12\x16", b"\x12\x15"])
@pytest.mark.parametrize(("simulator", "port"), MODELS, ids=IDS)
def test_a_control_sequence_with_its_terminator_has_one_prompt(
    simulator: Any, port: str, control: bytes, end: bytes
) -> None:
    client, revision = Client(simulator, port), REVISION[simulator.model]
    for pieces in ((control + end,), (control[:1], control[1:], end), (control, end)):
        assert client.ask(*pieces) == revision
        assert client.ask(b'MG "a"\r') == b"a\r\n:"
    assert client.ask(control + end + b"MG 1{F1.0}\r") == revision + b" 1\r\n:"
    assert client.ask(b"\r") == b":"


@pytest.mark.parametrize(("simulator", "port"), MODELS, ids=IDS)
def test_the_other_readings_of_a_control_sequence(simulator: Any, port: str) -> None:
    revision = REVISION[simulator.model]
    separate = Client(simulator, port, control_end="separate")
    assert separate.ask(b"\x12\x16") == revision
    assert separate.ask(b"\x12\x16\r\n") == revision + b":"
    required = Client(simulator, port, control_end="required")
    assert required.ask(b"\x12\x16") == b""
    assert required.ask(b"\r") == revision
    assert required.ask(b"\x12\x16;MG 1{F1.0}\r") == revision + b" 1\r\n:"


@pytest.mark.parametrize(("simulator", "port"), MODELS, ids=IDS)
def test_a_master_reset_with_its_terminator_has_one_prompt(simulator: Any, port: str) -> None:
    client = Client(simulator, port)
    client.ask(b"PRX=7\r")
    assert client.ask(b"\x12\x13\r").count(b":") == 1
    client.ask(b"EO 0\r")
    assert client.ask(b"MG _PRX{F1.0}\r") == b" 0\r\n:"


@pytest.mark.parametrize(("simulator", "port"), MODELS, ids=IDS)
def test_semicolons_alone_end_any_number_of_commands(simulator: Any, port: str) -> None:
    """L1624, L12230: an answered command no longer counts."""
    client = Client(simulator, port)
    for number in range(300):
        assert client.ask(b"V1=%d;" % number) == b":"
    assert client.ask(b"MG V1{F3.0};") == b" 299\r\n:"
    # In pieces of any size the answers are the same.
    text = b"V1=1;V2=2;MG V1+V2{F1.0};" * 8
    assert client.ask(text) == client.ask(*(text[at : at + 1] for at in range(len(text)))) == b":: 3\r\n:" * 8


@pytest.mark.parametrize(("simulator", "port"), MODELS, ids=IDS)
@pytest.mark.parametrize("end", [b";", b"\r"])
def test_a_command_that_is_too_long_is_refused_and_forgotten(simulator: Any, port: str, end: bytes) -> None:
    client = Client(simulator, port)
    longest = b"V1=" + b"1+" * 38 + b"1"
    assert len(longest) == 80
    assert client.ask(longest + end) == b":"
    too_long = b"V1=" + b"1+" * 39 + b"1" + end
    assert client.ask(too_long) == b"?"
    assert client.ask(*(bytes([each]) for each in too_long)) == b"?"
    assert client.ask(b"TC1\r") == b"5 Input buffer full\r\n:"
    assert client.ask(b"x" * 5000) == b""
    assert client.ask(end) == b"?"
    assert client.ask(b"MG V1{F2.0}\r") == b" 39\r\n:"


def test_tcp_has_no_packets() -> None:
    """L1735 limits packets; what TCP delivers at once is as long as it happens to be."""
    client = Client(SMC4000, "tcp")
    assert client.ask(b"".join(b"V1=%d\r" % number for number in range(500))) == b":" * 500
    assert client.ask(b"V1=%d\r" % 1 * 100 + b"V", b"1=2\r") == b":" * 101
    lines = b"".join(b"V1=%d;V2=V1\r" % number for number in range(200))
    assert client.ask(b"DL\r" + lines + b"\x1a") == b":"


def test_a_datagram_of_more_than_a_packet_is_refused() -> None:
    client = Client(SMC4000, "udp")
    assert client.ask(b"V1=1\r" * 94) == b":" * 94
    assert client.ask(b"V1=1\r" * 95) == b"?"
    assert client.ask(b"TC1\r") == b"122 Ethernet input buffer overrun\r\n:"


@pytest.mark.parametrize(("axis_bytes", "axes"), [(26, 4), (28, 4), (26, 2), (28, 2)])
def test_the_record_has_the_sizes_that_qz_states(axis_bytes: int, axes: int) -> None:
    """A client that computes the record's length from QZ finds the prompt after it (L8985, L9190)."""
    client = Client(SMC4000, "tcp", qr_axis_bytes=axis_bytes, axes=axes)
    stated = [int(field) for field in client.ask(b"QZ\r").split(b"\r")[0].split(b",")]
    assert stated == [axes, 24, 16, axis_bytes]
    count, general, planes, axis = stated
    whole = client.ask(b"QR\r")
    assert len(whole) == 4 + general + planes + count * axis + 1 and whole.endswith(b":")
    assert struct.unpack("<H", whole[2:4])[0] == len(whole) - 1
    assert len(client.ask(b"QR ST\r")) == 4 + planes + 1


@pytest.mark.parametrize(("simulator", "port"), MODELS, ids=IDS)
def test_the_prompt_follows_the_end_of_an_uploaded_program(simulator: Any, port: str) -> None:
    for options, end in (({}, b"\x1a:"), ({"upload_line_end": True}, b"\x1a\r\n:")):
        client = Client(simulator, port, **options)
        client.ask(b"DL\r#A\rEN\r\x1a")
        assert client.ask(b"UL\r") == b"#A\r\nEN\r\n" + end
