"""A client that uses nothing of this project, but a socket and the manual, drives a simulated SMC-4000 over TCP."""

import socket
import struct
import time

import pytest
from children import Children

pytestmark = pytest.mark.live

PROGRAM = "#MOVE\rDP 0,0;SP 40000,20000\rPR 8000,-4000\rBG XY;AM XY\rDONE=1\rEN\r"
MOVE_IN_PROGRESS = 1 << 15


def read_until(line: socket.socket, ends: bytes) -> bytes:
    """Everything up to the first byte that is one of `ends`."""
    answer = b""
    while not answer or answer[-1:] not in ends:
        answer += line.recv(1)
    return answer


def ask(line: socket.socket, command: str) -> str:
    """One command in a packet of its own, its data without the prompt (L1629, L1741)."""
    line.sendall(f"{command}\r".encode())
    answer = read_until(line, b":?").decode()
    assert answer.endswith(":"), f"{command}: refused"
    return answer[:-1].strip()


def record(line: socket.socket) -> tuple[list[tuple[int, ...]], int]:
    """The blocks of axes A and B, and the sample number (L8697-L8919)."""
    line.sendall(b"QR ABI\r")
    head = line.recv(4, socket.MSG_WAITALL)
    length = struct.unpack("<H", head[2:])[0]
    body = line.recv(length - 4, socket.MSG_WAITALL)
    assert line.recv(1) == b":"
    general, axes = body[:24], body[24:]
    return [struct.unpack_from("<HBBiiiiih", axes, at) for at in (0, 26)], struct.unpack_from("<H", general)[0]


def test_a_plain_client_loads_a_program_runs_it_and_reads_the_record(children: Children) -> None:
    _, place = children.simulator("smc4000", "tcp:127.0.0.1:0")
    with socket.create_connection((place["host"], place["port"]), timeout=10.0) as line:
        ask(line, "SH XY")
        line.sendall(b"DL\r")
        line.sendall(PROGRAM.encode())
        line.sendall(b"\x1a")
        assert read_until(line, b":?") == b":"
        line.sendall(b"UL\r")
        assert read_until(line, b":?").decode().split("\x1a")[0].replace("\r\n", "\r") == PROGRAM
        ask(line, "DONE=0")
        ask(line, "XQ #MOVE")
        (first, _), began = record(line)
        deadline_s = time.monotonic() + 10.0
        while ask(line, "MG DONE") != "0000000001.0000":
            assert time.monotonic() < deadline_s, "the program does not end"
        (x, y), ended = record(line)
        assert first[0] & MOVE_IN_PROGRESS
        assert not x[0] & MOVE_IN_PROGRESS
        assert [x[3], x[4], y[3], y[4]] == [8000, 8000, -4000, -4000]
        assert (ended - began) % 65536 > 200
        assert ask(line, "TP XY") == "0000008000,-0000004000"
        assert ask(line, "SC XY") == "001, 001"
