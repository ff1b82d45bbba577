"""Traces of a CAN link as log files, read back by python-can."""

from pathlib import Path

import can
import pytest

from adapters.link.can_log import LogFormat, write_log
from orchestrator.link.can import CanFrame, encode_frames
from orchestrator.link.trace import TraceEntry

ENTRIES: list[TraceEntry] = [
    (1_000_000_000, "out", encode_frames(CanFrame(0x080), CanFrame(0x201, b"\x0f\0"))),
    (1_002_000_000, "in", encode_frames(CanFrame(0x181, b"\x37\x02"))),
    (1_003_000_000, "in", encode_frames(CanFrame(0x1ABCDEF, b"\x01", extended=True))),
    (1_004_000_000, "out", encode_frames(CanFrame(0x701, b"\0", rtr=True))),
]


@pytest.mark.parametrize(("form", "ending"), [("asc", "asc"), ("blf", "blf"), ("candump", "log")])
def test_a_log_holds_every_frame_with_its_time(form: LogFormat, ending: str, tmp_path: Path) -> None:
    path = tmp_path / f"bus.{ending}"
    assert write_log(path, form, ENTRIES, 1_700_000_000.0) == 5
    with can.LogReader(path) as log:
        messages = list(log)
    assert [(each.arbitration_id, each.is_extended_id, each.is_remote_frame) for each in messages] == [
        (0x080, False, False),
        (0x201, False, False),
        (0x181, False, False),
        (0x1ABCDEF, True, False),
        (0x701, False, True),
    ]
    assert [bytes(each.data) for each in messages[:4]] == [b"", b"\x0f\0", b"\x37\x02", b"\x01"]
    assert messages[2].timestamp - messages[0].timestamp == pytest.approx(0.002, abs=1e-5)
    if form == "candump":
        assert messages[0].timestamp == pytest.approx(1_700_000_001.0, abs=1e-5)


def test_bytes_of_another_link_are_no_frames(tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="5 bytes"):
        write_log(tmp_path / "x.asc", "asc", [(0, "out", b"MG 1\r")], 0.0)
    assert not (tmp_path / "x.asc").exists()
