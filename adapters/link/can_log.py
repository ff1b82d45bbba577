"""Export of the traffic of a CAN link as a log file for other tools: Vector's ASC and BLF, candump's log."""

from collections.abc import Sequence
from pathlib import Path
from typing import Literal

import can

from orchestrator.link.can import CanFrame, decode_frames
from orchestrator.link.trace import TraceEntry

LogFormat = Literal["asc", "blf", "candump"]
_WRITERS = {"asc": can.ASCWriter, "blf": can.BLFWriter, "candump": can.CanutilsLogWriter}


def write_log(path: Path, form: LogFormat, entries: Sequence[TraceEntry], origin_s: float) -> int:
    """Write the frames of a link's trace to `path`; return their number.

    origin_s: Unix time of host time 0. Raises `ValueError` when the bytes are not frames, `OSError`.
    """
    messages = [
        _make_message(frame, at_ns / 1e9 + origin_s, received=direction == "in")
        for at_ns, direction, data in entries
        for frame in decode_frames(data)
    ]
    with _WRITERS[form](path) as log:
        for message in messages:
            log.on_message_received(message)
    return len(messages)


def _make_message(frame: CanFrame, at_s: float, *, received: bool) -> can.Message:
    return can.Message(
        timestamp=at_s,
        arbitration_id=frame.id,
        is_extended_id=frame.extended,
        is_remote_frame=frame.rtr,
        is_error_frame=frame.error,
        is_rx=received,
        dlc=len(frame.data),
        data=None if frame.rtr else frame.data,
        channel=0,
    )
