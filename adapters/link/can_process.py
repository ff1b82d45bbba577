"""The process of one CAN interface: frames between a socket and python-can, which is opened here and nowhere else.

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
from orchestrator.link.can import CanFrame, decode, encode

LOOK_S = 0.2
"""How often the reader looks whether it is to end."""
_SLCAN: dict[str, Any] = {"sleep_after_open": 0.0}  # python-can waits 2 s for boards that are reset by being opened


def frame_of(message: can.Message) -> CanFrame | None:
    """None for what is no frame of classical CAN."""
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


def message_of(frame: CanFrame) -> can.Message:
    return can.Message(
        arbitration_id=frame.id,
        is_extended_id=frame.extended,
        is_remote_frame=frame.rtr,
        dlc=len(frame.data),
        data=None if frame.rtr else frame.data,
    )


class _Pump:
    """Two threads, one for each direction. What fails in one ends both."""

    def __init__(self, bus: can.BusABC, link: socket.socket) -> None:
        self._bus = bus
        self._link = link
        self._over = threading.Event()

    def run(self) -> None:
        reader = threading.Thread(target=self._guard, args=(self._read,))
        reader.start()
        self._guard(self._write)
        reader.join()

    def _guard(self, work: Any) -> None:
        try:
            work()
        except (can.CanError, OSError, ValueError) as error:
            if not self._over.is_set():
                _say(self._link, ERROR + f"{error}; check cable, termination and bit rate of the bus".encode())
        finally:
            self._over.set()
            with contextlib.suppress(OSError):
                self._link.shutdown(socket.SHUT_RDWR)

    def _write(self) -> None:
        while data := self._link.recv(DATAGRAM):
            for frame in decode(data):
                self._bus.send(message_of(frame))

    def _read(self) -> None:
        while not self._over.is_set():
            message = self._bus.recv(LOOK_S)
            stamp = time.clock_gettime_ns(time.CLOCK_MONOTONIC_RAW).to_bytes(STAMP_BYTES, "little")
            frame = None if message is None else frame_of(message)
            if frame is not None:
                self._link.send(FRAMES + stamp + encode(frame))


def _say(link: socket.socket, data: bytes) -> None:
    with contextlib.suppress(OSError):
        link.send(data)


def main(fd: int, interface: str, channel: str, bitrate: int) -> int:
    """Gives 0, or 2 when the interface can not be opened."""
    link = socket.socket(fileno=fd)
    os.set_blocking(fd, True)
    more = _SLCAN if interface == "slcan" else {}
    try:
        bus = can.Bus(interface=interface, channel=channel, bitrate=bitrate, **more)
    except Exception as error:  # interfaces raise whatever their drivers do
        text = f"the interface {interface} can not be opened: {error}; check `interface`, `channel` and the CAN adapter"
        _say(link, ERROR + text.encode())
        return 2
    with bus:
        _say(link, READY)
        _Pump(bus, link).run()
    return 0


if __name__ == "__main__":
    raise SystemExit(main(int(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4])))
