"""The arguments of a simulator's process, and the lines that change its world."""

from pathlib import Path

import pytest

from orchestrator.clock.queue import EventQueue
from sim.core.vectors import find_simulator
from sim.link.arguments import PtyAddress, TcpAddress, parse_arguments
from sim.link.world import EnvironmentRefused, change_environment

USUAL = ["--model", "smc4000", "--name", "gantry"]


@pytest.mark.parametrize(
    ("text", "place"),
    [
        ("tcp:127.0.0.1:2300", TcpAddress("127.0.0.1", 2300)),
        ("tcp:[::1]:0", TcpAddress("::1", 0)),
        ("pty:/tmp/port", PtyAddress(Path("/tmp/port"))),
    ],
)
def test_places(text: str, place: TcpAddress | PtyAddress) -> None:
    assert parse_arguments([*USUAL, "--listen", text])[0].listen == place


@pytest.mark.parametrize(("frame", "bits"), [("8N1", 10), ("7O1", 10), ("8E2", 12)])
def test_frames(frame: str, bits: int) -> None:
    assert parse_arguments([*USUAL, "--listen", "pty:x", "--frame", frame])[0].frame == bits
    assert parse_arguments([*USUAL, "--listen", "pty:x"])[0].frame == 10


@pytest.mark.parametrize(
    "wrong",
    [
        ["--listen", "tcp:192.168.1.2:80"],
        ["--listen", "tcp:127.0.0.1:99999"],
        ["--listen", "pty:"],
        ["--listen", "pty:x", "--baud", "0"],
        ["--listen", "pty:x", "--frame", "9N1"],
        ["--listen", "pty:x", "--options", "[]"],
        ["--listen", "pty:x", "--options", "{"],
        ["--listen", "pty:x", "--oscillator", '{"drift": 1}'],
    ],
)
def test_an_error_is_reported_in_one_line(wrong: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        parse_arguments([*USUAL, *wrong])
    assert end.value.code == 2
    assert capsys.readouterr().err.count("\n") == 1


@pytest.mark.parametrize(
    ("line", "named"),
    [
        ("{", "JSON"),
        ('{"axis": 1}', "axis"),
        ('{"limit": ["Q", "forward"]}', "no axis 'Q'"),
        ('{"limit": ["X", "sideways"]}', "limit.1"),
        ('{"input": [0, true]}', "input.0"),
    ],
)
def test_the_refusal_of_a_line_reports_the_reason(line: str, named: str) -> None:
    controller = find_simulator("smc4000").build_controller(EventQueue(), {})
    with pytest.raises(EnvironmentRefused, match=named):
        change_environment(controller, line)


def test_the_world_is_changed() -> None:
    controller = find_simulator("smc4000").build_controller(EventQueue(), {})
    for line in (
        '{"power": false}',
        '{"power": true}',
        '{"input": [1, false]}',
        '{"limit": ["X", "forward"], "stall": ["X", true]}',
    ):
        change_environment(controller, line)
