"""The process of one CAN interface: frames between a socket and python-can, which is opened only here.

`python -m adapters.link.can_process FD INTERFACE CHANNEL BITRATE`. It ends when the other end of the socket is closed.
"""

import contextlib
import os
import socket
import sys
import threading
import time
from typing import Any

import can

from adapters.link.can import DATAGRAM, ERROR, FRAMES, READY, STAMP_BYTES
from orchestrator.link.can import CanFrame, decode_frames, encode_frames

END_CHECK_S = 0.2
"""Interval at which the reader checks whether to end."""
_SLCAN: dict[str, Any] = {"sleep_after_open": 0.0}  # python-can waits 2 s for boards that reset when they are opened


def frame_from_message(message: can.Message) -> CanFrame | None:
    """Convert a message to a frame; None for a message that is not a frame of classical CAN."""
    if message.is_fd:
        return None
    data = bytes(message.dlc) if message.is_remote_frame else bytes(message.data)
    return CanFrame(
        id=message.arbitration_id,
        data=data,
        extended=message.is_extended_id and not message.is_error_frame,
        rtr=message.is_remote_frame,
        error=message.is_error_frame,
    )


def message_from_frame(frame: CanFrame) -> can.Message:
    return can.Message(
        arbitration_id=frame.id,
        is_extended_id=frame.extended,
        is_remote_frame=frame.rtr,
        dlc=len(frame.data),
        data=None if frame.rtr else frame.data,
    )


class _FramePump:
    """Two threads, one for each direction. A failure in one ends both."""

    def __init__(self, bus: can.BusABC, link: socket.socket) -> None:
        self._bus = bus
        self._link = link
        self._ended = threading.Event()

    def run(self) -> None:
        reader = threading.Thread(target=self._run_guarded, args=(self._read_frames,))
        reader.start()
        self._run_guarded(self._write_frames)
        reader.join()

    def _run_guarded(self, work: Any) -> None:
        try:
            work()
        except (can.CanError, OSError, ValueError) as error:
            if not self._ended.is_set():
                _send_datagram(
                    self._link, ERROR + f"{error}; check cable, termination and bit rate of the bus".encode()
                )
        finally:
            self._ended.set()
            with contextlib.suppress(OSError):
                self._link.shutdown(socket.SHUT_RDWR)

    def _write_frames(self) -> None:
        while data := self._link.recv(DATAGRAM):
            for frame in decode_frames(data):
                self._bus.send(message_from_frame(frame))

    def _read_frames(self) -> None:
        while not self._ended.is_set():
            message = self._bus.recv(END_CHECK_S)
            stamp = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW).to_bytes(STAMP_BYTES, "little")
            frame = None if message is None else frame_from_message(message)
            if frame is not None:
                self._link.send(FRAMES + stamp + encode_frames(frame))


def _send_datagram(link: socket.socket, data: bytes) -> None:
    with contextlib.suppress(OSError):
        link.send(data)


def main(fd: int, interface: str, channel: str, bitrate: int) -> int:
    """Run the process. Return 0, or 2 when the interface cannot be opened."""
    link = socket.socket(fileno=fd)
    os.set_blocking(fd, True)
    more = _SLCAN if interface == "slcan" else {}
    try:
        bus = can.Bus(interface=interface, channel=channel, bitrate=bitrate, **more)
    except Exception as error:  # an interface raises whatever its driver raises
        text = f"the interface {interface} cannot be opened: {error}; check `interface`, `channel` and the CAN adapter"
        _send_datagram(link, ERROR + text.encode())
        return 2
    with bus:
        _send_datagram(link, READY)
        _FramePump(bus, link).run()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(int(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4])))
