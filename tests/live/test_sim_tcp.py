"""A simulated SMC-4000 on a real socket, driven by a plain client."""

import json
import socket
from typing import Any

import pytest
from children import LIMIT_S, Children, ready, tell, wait_until

from orchestrator.clock.live import raw_ns

pytestmark = pytest.mark.live

HANDLES = 8


def client(place: dict[str, Any]) -> socket.socket:
    return socket.create_connection((place["host"], place["port"]), timeout=LIMIT_S)


def ask(line: socket.socket, command: bytes) -> bytes:
    """Send a command and return its answer, up to the prompt."""
    line.sendall(command)
    answer = b""
    while not answer.endswith((b":", b"?")):
        data = line.recv(1000)
        assert data, "the controller hung up"
        answer += data
    return answer


def refused(place: dict[str, Any]) -> None:
    """Check that a connection is reset: already while it is made, if the reset comes before the client reads it."""
    with pytest.raises(ConnectionResetError), client(place) as line:
        line.recv(1)


def number(answer: bytes) -> float:
    """The value that `MG` has answered."""
    return float(answer.split()[0])


def test_it_answers_like_hardware_and_its_time_continues(children: Children) -> None:
    _, place = children.simulator("smc4000", "tcp:127.0.0.1:0")
    with client(place) as line:
        first, second = [number(ask(line, b"MG TIME\r")) for _ in range(2)]
        assert ask(line, b"ZZ 1\r") == b"?"
        assert second >= first
        assert number(ask(line, b"MG 7\r")) == 7


def test_a_ninth_handle_is_reset_and_a_client_that_vanishes_frees_its_own(children: Children) -> None:
    _, place = children.simulator("smc4000", "tcp:127.0.0.1:0")
    handles = [client(place) for _ in range(HANDLES)]
    try:
        for handle in handles:
            ask(handle, b"MG 1\r")
        refused(place)
        handles[3].sendall(b"MG TI")
        handles[3].close()

        def is_free() -> bool:
            try:
                handles[3] = client(place)
                return number(ask(handles[3], b"MG 7\r")) == 7
            except ConnectionResetError:
                handles[3].close()
                return False

        wait_until(is_free, "a free handle")
    finally:
        for handle in handles:
            handle.close()


def test_one_process_serves_several_links_each_with_a_controller_of_its_own(children: Children) -> None:
    other = ["--next", "--model", "smc4000", "--name", "other", "--listen", "tcp:127.0.0.1:0"]
    process, place = children.simulator("smc4000", "tcp:127.0.0.1:0", *other)
    there = json.loads(ready(process))
    assert (place["name"], there["name"]) == ("unit", "other")
    with client(place) as line, client(there) as second:
        assert ask(line, b"XT=5\r") == b":"
        assert ask(second, b"XT=6\r") == b":"
        assert number(ask(line, b"MG XT\r")) == 5


def test_the_one_of_several_links_that_cannot_be_served_is_reported(children: Children) -> None:
    _, place = children.simulator("smc4000", "tcp:127.0.0.1:0")
    taken = f"tcp:127.0.0.1:{place['port']}"
    usual = ["--model", "smc4000", "--listen"]
    process = children.start(
        "sim.link.process", *usual, "tcp:127.0.0.1:0", "--name", "unit", "--next", *usual, taken, "--name", "other"
    )
    _, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 2
    assert said.startswith("other: port ") and "is in use" in said and said.count("\n") == 1


def test_the_truth_is_recorded_in_host_time(children: Children) -> None:
    truth = children.folder / "deep" / "truth.jsonl"
    _, place = children.simulator("smc4000", "tcp:127.0.0.1:0", "--truth", str(truth))
    with client(place) as line:
        before_ns = raw_ns()
        ask(line, b"SH X;PR 2000;SP 20000;AC 256000;DC 256000;BG X\r")
        wait_until(lambda: truth.read_text().count("\n") == 2, "the motion's start and end")
    start, end = [json.loads(text) for text in truth.read_text().splitlines()]
    assert (start["event"], end["event"], start["axis"]) == ("start", "end", "X")
    assert before_ns < end["start_ns"] < end["end_ns"] < raw_ns()
    assert end["end_counts"] - end["start_counts"] == pytest.approx(2000, abs=1)


def test_the_instant_at_which_a_stop_took_effect_is_recorded(children: Children) -> None:
    truth = children.folder / "truth.jsonl"
    _, place = children.simulator("smc4000", "tcp:127.0.0.1:0", "--truth", str(truth))
    with client(place) as line:
        for command in (b"SHX\r", b"JGX=20000\r", b"BGX\r"):
            ask(line, command)
        wait_until(lambda: truth.read_text() != "", "the motion's start")
        before_ns = raw_ns()
        ask(line, b"STX\r")
        wait_until(lambda: truth.read_text().count("\n") == 3, "the motion's start, slowing and end")
    start, slowing, end = [json.loads(text) for text in truth.read_text().splitlines()]
    assert (start["event"], slowing["event"], end["event"]) == ("start", "slowing", "end")
    assert before_ns < slowing["slowing_ns"] < end["end_ns"] < raw_ns()


def test_power_off_drops_connections_and_power_on_takes_new_ones(children: Children) -> None:
    process, place = children.simulator("smc4000", "tcp:127.0.0.1:0")
    with client(place) as line:
        ask(line, b"MG 1\r")
        tell(process, power=False)
        assert line.recv(1) == b""
    refused(place)
    tell(process, power=True)

    def answers() -> bool:
        try:
            with client(place) as line:
                return bool(ask(line, b"MG 1\r"))
        except ConnectionResetError:
            return False

    wait_until(answers, "an answer after power-on")


def test_the_world_is_changed_by_lines_and_a_wrong_one_does_no_harm(children: Children) -> None:
    process, place = children.simulator("smc4000", "tcp:127.0.0.1:0")
    with client(place) as line:
        before = ask(line, b"MG @IN[1]\r")
        tell(process, nonsense=1)
        tell(process, input=[1, number(before) == 0])
        wait_until(lambda: ask(line, b"MG @IN[1]\r") != before, "the input's other level")
        tell(process, push=["X", 500])
        wait_until(lambda: b"500" in ask(line, b"TPX\r"), "the pushed axis")


def test_it_ends_with_its_standard_input(children: Children) -> None:
    process, _ = children.simulator("smc4000", "tcp:127.0.0.1:0")
    assert process.stdin is not None
    process.stdin.close()
    assert process.wait(LIMIT_S) == 0


@pytest.mark.parametrize(
    ("wrong", "named"),
    [
        (["--model", "smc5000"], "known models"),
        (["--listen", "udp:1"], "udp:1"),
        (["--listen", "tcp:0.0.0.0:1"], "0.0.0.0"),
        (["--options", '{"axes": 3}'], "axes"),
        (["--timing", '{"decode_ns": -1}'], "decode_ns"),
        (["--model", "shrc203", "--listen", "udp:127.0.0.1:0"], "serial"),
    ],
)
def test_a_wrong_argument_is_one_line_and_code_2(children: Children, wrong: list[str], named: str) -> None:
    usual = ["--model", "smc4000", "--name", "unit", "--listen", "tcp:127.0.0.1:0"]
    process = children.start("sim.link.process", *usual, *wrong)
    _, said = process.communicate(timeout=LIMIT_S)
    assert process.returncode == 2
    assert named in said
    assert said.count("\n") == 1
