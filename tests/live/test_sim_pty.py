"""A simulated SHRC-203 on a pseudo-terminal, driven by pyserial."""

import time
from pathlib import Path

import pytest
import serial
from children import LIMIT_S, Children, wait_until

pytestmark = pytest.mark.live

BAUD = 9600
CHAR_S = 10 / BAUD
KERNEL_BYTES = 700_000  # more than it keeps unread of a terminal


def client(port: Path) -> serial.Serial:
    return serial.Serial(str(port), BAUD, timeout=LIMIT_S, exclusive=True)


@pytest.fixture
def port(children: Children) -> Path:
    path = children.folder / "ports" / "stage"
    _, place = children.simulator("shrc203", f"pty:{path}", "--baud", str(BAUD))
    assert place["device"] == str(path)
    return path


def test_an_exchange_takes_its_time_on_the_wire(port: Path) -> None:
    with client(port) as line:
        begun_s = time.monotonic()
        line.write(b"*IDN?\r\n")
        answer = line.readline()
        took_s = time.monotonic() - begun_s
    assert answer.startswith(b"SIGMAKOKI,SHRC-203")
    wire_s = (len(b"*IDN?\r\n") + len(answer)) * CHAR_S
    assert wire_s <= took_s < wire_s + 1.0


def test_lines_written_at_once_are_answered_one_after_another(port: Path) -> None:
    with client(port) as line:
        begun_s = time.monotonic()
        line.write(b"*IDN?\r\n" * 3)
        answers = [line.readline() for _ in range(3)]
        took_s = time.monotonic() - begun_s
    assert took_s > sum(map(len, answers)) * CHAR_S


def test_it_survives_clients_that_come_and_go(port: Path) -> None:
    for _ in range(3):
        with client(port) as line:
            line.write(b"*IDN?\r\n")
            assert line.readline().startswith(b"SIGMAKOKI")


def test_a_client_that_does_not_read_blocks_no_other(children: Children) -> None:
    path, truth = children.folder / "fast", children.folder / "truth.jsonl"
    children.simulator("shrc203", f"pty:{path}", "--baud", "4000000", "--truth", str(truth))
    identity = b"SIGMAKOKI,SHRC-203,2106001001,V2.00.000\r\n"
    with client(path) as deaf:
        for _ in range(KERNEL_BYTES // len(identity)):
            deaf.write(b"*IDN?\r\n")
        deaf.write(b"M:1+P2000\r\nG:\r\n")
        wait_until(lambda: truth.read_text().count("\n") == 2, "the motion that was asked for behind all that")
        assert deaf.read(3 * len(identity)) == identity * 3
        deaf.reset_input_buffer()
        deaf.write(b"*IDN?\r\n")
        assert deaf.readline() == identity


def test_a_file_in_the_way_is_refused(children: Children) -> None:
    path = children.folder / "file"
    path.write_text("mine")
    process = children.start("sim.link.process", "--model", "shrc203", "--name", "s", "--listen", f"pty:{path}")
    _, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 2
    assert "choose another name" in said
    assert path.read_text() == "mine"


def test_the_name_is_removed_and_an_old_one_replaced(children: Children) -> None:
    path = children.folder / "name"
    path.symlink_to("/dev/pts/9999")
    process, _ = children.simulator("shrc203", f"pty:{path}")
    assert path.is_char_device()
    process.terminate()
    process.wait(LIMIT_S)
    assert not path.is_symlink()
