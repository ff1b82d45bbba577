"""The bytes on a controller's link as frames, decoded by its make."""

from collections.abc import Iterator
from typing import NamedTuple

from adapters.host.makes import find_decoder
from adapters.toolkit.frames import DecodedFrame, FrameDecoder, printable_text
from orchestrator.model.messages import TraceReply
from orchestrator.monitor.times import format_time


class ShownFrame(NamedTuple):
    """A frame. after_s: since the first request. fleet_ns: None while fleet time is not known."""

    after_s: float
    fleet_ns: int | None
    direction: str
    address: str
    text: str
    meaning: str


class FrameList:
    """The frames of a trace that is read in parts; times are relative to the first one."""

    def __init__(self, first: TraceReply, *, raw: bool) -> None:
        self._origin_ns, self._origin_utc = first.host_ns, first.utc
        self._decoder: FrameDecoder | None = None if raw else find_decoder(first.make, first.options)

    def describe_origin(self) -> str:
        """Which instant is 0 s."""
        return f"{format_time(self._origin_utc, precise=True)} is 0 s"

    def read_frames(self, reply: TraceReply) -> Iterator[ShownFrame]:
        """The frames that a part of the trace completes."""
        for at_ns, direction, text in reply.entries:
            data = text.encode("latin-1")
            fleet_ns = None if reply.fleet_ns is None else reply.fleet_ns + at_ns - reply.host_ns
            frames = (
                [DecodedFrame(printable_text(data))]
                if self._decoder is None
                else self._decoder.decode_bytes(direction, data)
            )
            for frame in frames:
                after_s = (at_ns - self._origin_ns) / 1e9
                yield ShownFrame(
                    after_s=after_s,
                    fleet_ns=fleet_ns,
                    direction=direction,
                    address=frame.address,
                    text=frame.text,
                    meaning=frame.meaning,
                )
