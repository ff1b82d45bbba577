"""The client of one node's SDO server: one transfer at a time, expedited both ways, segmented for texts."""

import asyncio
from collections import deque

from adapters.cia402.bus import SDO_REQUEST, Bus
from adapters.cia402.objects import Obj
from adapters.cia402.words import TIMED_OUT, abort_text
from adapters.contract import DriverFault
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.can import CanFrame

_UPLOAD, _DOWNLOAD, _ABORT = 0x40, 0x20, 0x80
_UPLOAD_ANSWER, _DOWNLOAD_ANSWER = 0x40, 0x60
_EXPEDITED, _SIZED = 0x02, 0x01
_SPECIFIER = 0xE0
_STRAYS = 3  # so many second answers are no accident
_STRAY_NS = 1000 * NS_PER_MS


class SdoAborted(DriverFault):
    """The node does not do what was asked. abort: its code."""

    def __init__(self, name: str, obj: Obj, what: str, abort: int) -> None:
        super().__init__(
            "sdo-abort",
            f"{name} refuses to {what} {obj}: {abort_text(abort)}",
            "does the drive have this object? Compare its EDS file and its manual",
        )
        self.abort = abort


class SdoClient:
    """Transfers to and from one node."""

    def __init__(self, bus: Bus, node: int, name: str, answer_ns: int) -> None:
        self._bus = bus
        self._node = node
        self._name = name
        self._answer_ns = answer_ns
        self._turn = asyncio.Lock()
        self._waiting: asyncio.Future[bytes] | None = None
        self._wanted: bytes | None = None
        self._answered: deque[tuple[bytes, int]] = deque(maxlen=1)
        self._strays = 0

    # What the node says

    def hear(self, data: bytes, at_ns: int) -> None:
        """An answer has come. One to something else, or a second one, is nobody's."""
        if len(data) != 8:
            return
        waiting = self._waiting
        if waiting is not None and not waiting.done() and self._fits(data):
            waiting.set_result(data)
            self._answered.append((data, at_ns))
        elif any(data == before and at_ns - then_ns < _STRAY_NS for before, then_ns in self._answered):
            self._strays += 1
            # Once a request: a drive that nobody has acknowledged for a while lets its old answers go all at once.
            self._answered.clear()

    def _fits(self, data: bytes) -> bool:
        if self._wanted is None:
            return data[0] & _SPECIFIER in (0x00, _ABORT)  # a segment has no address
        return data[1:4] == self._wanted and data[0] & _SPECIFIER in (_UPLOAD_ANSWER, _DOWNLOAD_ANSWER, _ABORT)

    def fail(self, error: Exception) -> None:
        """What is waited for does not come any more."""
        if self._waiting is not None and not self._waiting.done():
            self._waiting.set_exception(error)

    # Transfers

    async def read(self, obj: Obj) -> int:
        """Raises `SdoAborted`, `DriverFault` (no-answer, two-answers, bus-off), `LinkClosed`."""
        async with self._turn:
            data = await self._ask(obj, "read", bytes([_UPLOAD]) + _address(obj) + bytes(4))
            self._require_specifier(obj, data, _UPLOAD_ANSWER)
            if not data[0] & _EXPEDITED:
                raise self._nonsense(obj, data)
            return obj.decode(data[4:])

    async def read_text(self, obj: Obj) -> str:
        """A text, in segments if need be. Raises as `read`."""
        async with self._turn:
            data = await self._ask(obj, "read", bytes([_UPLOAD]) + _address(obj) + bytes(4))
            self._require_specifier(obj, data, _UPLOAD_ANSWER)
            if data[0] & _EXPEDITED:
                unused = data[0] >> 2 & 3 if data[0] & _SIZED else 0
                return _text(data[4 : 8 - unused])
            text, toggle = b"", 0x00
            while True:
                segment = await self._ask(obj, "read", bytes([0x60 | toggle]) + bytes(7), segment=True)
                if segment[0] & 0x10 != toggle:
                    self._abort(obj, 0x0503_0000)
                    raise self._nonsense(obj, segment)
                text += segment[1 : 8 - (segment[0] >> 1 & 7)]
                if segment[0] & 0x01:
                    return _text(text)
                toggle ^= 0x10

    async def write(self, obj: Obj, value: int) -> None:
        """Raises as `read`."""
        async with self._turn:
            data = await self._ask(obj, f"take {value} for", download(obj, value))
            self._require_specifier(obj, data, _DOWNLOAD_ANSWER)

    async def _ask(self, obj: Obj, what: str, data: bytes, *, segment: bool = False) -> bytes:
        if self._strays >= _STRAYS:
            self._strays = 0
            raise DriverFault(
                "two-answers",
                f"{self._name} gives more answers than it was asked for",
                "do two drives have the same node number? Is another master on the bus?",
            )
        if self._bus.off:
            raise bus_off(self._name)
        self._wanted = None if segment else _address(obj)
        waiting = self._waiting = asyncio.get_running_loop().create_future()

        def too_late() -> None:
            if not waiting.done():
                waiting.set_exception(TimeoutError())

        timer = self._bus.clock.call_at_ns(self._bus.clock.now_ns() + self._answer_ns, too_late)
        try:
            self._bus.send(CanFrame(SDO_REQUEST + self._node, data))
            answer = await waiting
        except TimeoutError:
            self._abort(obj, TIMED_OUT)
            raise DriverFault(
                "no-answer",
                f"{self._name} has not answered to {what} {obj} within {self._answer_ns // NS_PER_MS} ms",
                "check its power, the cable, both terminations, its bit rate and its node number",
            ) from None
        finally:
            timer.cancel()
            self._waiting = None
        if answer[0] & _SPECIFIER == _ABORT:
            raise SdoAborted(self._name, obj, what, int.from_bytes(answer[4:8], "little"))
        return answer

    def _abort(self, obj: Obj, code: int) -> None:
        self._bus.send(CanFrame(SDO_REQUEST + self._node, bytes([_ABORT]) + _address(obj) + code.to_bytes(4, "little")))

    def _require_specifier(self, obj: Obj, data: bytes, wanted: int) -> None:
        if data[0] & _SPECIFIER != wanted:
            raise self._nonsense(obj, data)

    def _nonsense(self, obj: Obj, data: bytes) -> DriverFault:
        return DriverFault(
            "garbled-answer",
            f"{self._name} has answered {data.hex(' ')} about {obj}, which is no answer to that",
            "is another master on the bus?",
        )


def bus_off(name: str) -> DriverFault:
    """This computer's CAN controller is off the bus."""
    return DriverFault(
        "bus-off",
        f"{name} can not be reached: this computer's CAN controller has left the bus after too many errors",
        "check the cable, both terminations, and the bit rate of every node",
    )


def download(obj: Obj, value: int) -> bytes:
    """The expedited request that writes `value`."""
    unused = 4 - obj.size
    return bytes([_DOWNLOAD | unused << 2 | _EXPEDITED | _SIZED]) + _address(obj) + obj.encode(value) + bytes(unused)


def _address(obj: Obj) -> bytes:
    return obj.index.to_bytes(2, "little") + bytes([obj.sub])


def _text(data: bytes) -> str:
    return data.decode("latin-1").rstrip("\0 ")
