"""The client of one node's SDO server: one transfer at a time, expedited both ways, segmented for texts."""

import asyncio
from collections import deque

from adapters.cia402.canopen.bus import SDO_REQUEST, Cia402Bus
from adapters.cia402.canopen.objects import DictionaryObject
from adapters.cia402.canopen.words import TIMED_OUT, abort_text
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.can import CanFrame
from orchestrator.model.errors import ControllerFault

_UPLOAD, _DOWNLOAD, _ABORT = 0x40, 0x20, 0x80
_UPLOAD_ANSWER, _DOWNLOAD_ANSWER = 0x40, 0x60
_EXPEDITED, _SIZED = 0x02, 0x01
_SPECIFIER = 0xE0
_STRAYS = 3  # this number of duplicate answers is not an accident
_STRAY_NS = 1000 * NS_PER_MS


class SdoAborted(ControllerFault):
    """The node refuses a request. abort: its code."""

    def __init__(self, name: str, obj: DictionaryObject, what: str, abort: int) -> None:
        super().__init__(
            "sdo-abort",
            f"{name} refuses to {what} {obj}: {abort_text(abort)}",
            "does the drive have this object? Compare its EDS file and its manual",
        )
        self.abort = abort


class SdoClient:
    """Transfers to and from one node."""

    def __init__(self, bus: Cia402Bus, node: int, name: str, answer_ns: int) -> None:
        self._bus = bus
        self._node = node
        self._name = name
        self._answer_ns = answer_ns
        self._turn = asyncio.Lock()
        self._waiting: asyncio.Future[bytes] | None = None
        self._wanted: bytes | None = None
        self._answered: deque[tuple[bytes, int]] = deque(maxlen=1)
        self._strays = 0

    # Reception

    def handle_answer(self, data: bytes, at_ns: int) -> None:
        """Handle an answer. An answer to another request, or a duplicate, is discarded."""
        if len(data) != 8:
            return
        answer = self._waiting
        if answer is not None and not answer.done() and self._matches_request(data):
            answer.set_result(data)
            self._answered.append((data, at_ns))
        elif any(data == old_answer and at_ns - then_ns < _STRAY_NS for old_answer, then_ns in self._answered):
            self._strays += 1
            # Once per request: a drive whose frames were not acknowledged for a while sends its old answers all at
            # once.
            self._answered.clear()

    def _matches_request(self, data: bytes) -> bool:
        if self._wanted is None:
            return data[0] & _SPECIFIER in (0x00, _ABORT)  # a segment has no address
        return data[1:4] == self._wanted and data[0] & _SPECIFIER in (_UPLOAD_ANSWER, _DOWNLOAD_ANSWER, _ABORT)

    def fail_request(self, error: Exception) -> None:
        """Fail the outstanding request."""
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_exception(error)

    # Transfers

    async def read_value(self, obj: DictionaryObject) -> int:
        """Read an object. Raises `SdoAborted`, `ControllerFault` (no-answer, two-answers, bus-off), `LinkClosed`."""
        async with self._turn:
            data = await self._send_request(obj, "read", bytes([_UPLOAD]) + _object_address(obj) + bytes(4))
            self._require_specifier(obj, data, _UPLOAD_ANSWER)
            if not data[0] & _EXPEDITED:
                raise self._mismatch_fault(obj, data)
            return obj.decode(data[4:])

    async def read_text(self, obj: DictionaryObject) -> str:
        """Read a text, in segments if necessary. Raises like `read_value`."""
        async with self._turn:
            data = await self._send_request(obj, "read", bytes([_UPLOAD]) + _object_address(obj) + bytes(4))
            self._require_specifier(obj, data, _UPLOAD_ANSWER)
            if data[0] & _EXPEDITED:
                unused_size = data[0] >> 2 & 3 if data[0] & _SIZED else 0
                return _decode_text(data[4 : 8 - unused_size])
            text, toggle = b"", 0x00
            while True:
                segment = await self._send_request(obj, "read", bytes([0x60 | toggle]) + bytes(7), segment=True)
                if segment[0] & 0x10 != toggle:
                    self._raise_abort(obj, 0x0503_0000)
                    raise self._mismatch_fault(obj, segment)
                text += segment[1 : 8 - (segment[0] >> 1 & 7)]
                if segment[0] & 0x01:
                    return _decode_text(text)
                toggle ^= 0x10

    async def write_value(self, obj: DictionaryObject, value: int) -> None:
        """Write an object. Raises like `read_value`."""
        async with self._turn:
            data = await self._send_request(obj, f"take {value} for", download_request(obj, value))
            self._require_specifier(obj, data, _DOWNLOAD_ANSWER)

    async def _send_request(self, obj: DictionaryObject, what: str, data: bytes, *, segment: bool = False) -> bytes:
        if self._strays >= _STRAYS:
            self._strays = 0
            raise ControllerFault(
                "two-answers",
                f"{self._name} gives more answers than requested",
                "do two drives have the same node number? Is another master on the bus?",
            )
        if self._bus.is_off:
            raise bus_off_fault(self._name)
        self._wanted = None if segment else _object_address(obj)
        answer_future = self._waiting = asyncio.get_running_loop().create_future()

        def time_out() -> None:
            if not answer_future.done():
                answer_future.set_exception(TimeoutError())

        timer = self._bus.clock.call_at_ns(self._bus.clock.now_ns() + self._answer_ns, time_out)
        try:
            self._bus.send_frames(CanFrame(SDO_REQUEST + self._node, data))
            answer = await answer_future
        except TimeoutError:
            self._raise_abort(obj, TIMED_OUT)
            raise ControllerFault(
                "no-answer",
                f"{self._name} has not answered the request to {what} {obj} within {self._answer_ns // NS_PER_MS} ms",
                "check its power, the cable, both terminations, its bit rate and its node number",
            ) from None
        finally:
            timer.cancel()
            self._waiting = None
        if answer[0] & _SPECIFIER == _ABORT:
            raise SdoAborted(self._name, obj, what, int.from_bytes(answer[4:8], "little"))
        return answer

    def _raise_abort(self, obj: DictionaryObject, code: int) -> None:
        self._bus.send_frames(
            CanFrame(SDO_REQUEST + self._node, bytes([_ABORT]) + _object_address(obj) + code.to_bytes(4, "little"))
        )

    def _require_specifier(self, obj: DictionaryObject, data: bytes, wanted: int) -> None:
        if data[0] & _SPECIFIER != wanted:
            raise self._mismatch_fault(obj, data)

    def _mismatch_fault(self, obj: DictionaryObject, data: bytes) -> ControllerFault:
        return ControllerFault(
            "garbled-answer",
            f"{self._name} has answered {data.hex(' ')} to a request for {obj}, which does not match",
            "is another master on the bus?",
        )


def bus_off_fault(name: str) -> ControllerFault:
    """Return the fault for this computer's CAN controller being off the bus."""
    return ControllerFault(
        "bus-off",
        f"{name} is unreachable: this computer's CAN controller has left the bus after too many errors",
        "check the cable, both terminations, and the bit rate of every node",
    )


def download_request(obj: DictionaryObject, value: int) -> bytes:
    """Return the expedited request that writes `value`."""
    unused_size = 4 - obj.byte_size
    return (
        bytes([_DOWNLOAD | unused_size << 2 | _EXPEDITED | _SIZED])
        + _object_address(obj)
        + obj.encode(value)
        + bytes(unused_size)
    )


def _object_address(obj: DictionaryObject) -> bytes:
    return obj.index.to_bytes(2, "little") + bytes([obj.sub])


def _decode_text(data: bytes) -> str:
    return data.decode("latin-1").rstrip("\0 ")
