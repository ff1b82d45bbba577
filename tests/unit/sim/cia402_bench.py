"""Simulated drives on a bus in memory, and a client of them that a test drives step by step."""

from collections.abc import Mapping, Sequence

from orchestrator.clock.queue import EventQueue
from orchestrator.link.can import CanFrame, FrameReader, encode_frames
from sim.cia402 import CIA402
from sim.cia402.unit import SimulatedDrive
from sim.core.controller import DeviceSpec, FirmwareTiming
from sim.core.oscillator import Oscillator
from sim.link.can_card import CanSegment

MS = 1_000_000
US = 1_000


class Aborted(Exception):
    """The drive has refused; `code` is its SDO abort code."""

    def __init__(self, code: int) -> None:
        super().__init__(f"{code:#010x}")
        self.code = code


class CanBench:
    """Drives with the nodes 1, 2, … on one bus, after their boot-up unless `boot` is false."""

    def __init__(
        self,
        count: int = 1,
        options: Mapping[str, object] | Sequence[Mapping[str, object]] | None = None,
        boot: bool = True,
        drift_ppm: Sequence[float] = (),
    ) -> None:
        self.clock = EventQueue()
        each = [options or {}] * count if not isinstance(options, Sequence) else list(options)
        branches = [
            DeviceSpec(
                node,
                each[node - 1],
                Oscillator(drift_ppm=drift_ppm[node - 1] if drift_ppm else 0.0),
                FirmwareTiming(decode_ns=200 * US),
                seed=node,
            )
            for node in range(1, count + 1)
        ]
        segment, units = CIA402.build_shared(self.clock, branches)
        assert isinstance(segment, CanSegment)
        self.segment = segment
        self.bus = segment.bus
        self.units: Sequence[SimulatedDrive] = units
        self.frames: list[tuple[int, CanFrame]] = []
        reader = FrameReader()

        def heard(data: bytes) -> None:
            self.frames.extend((self.clock.now_ns(), frame) for frame in reader.add_bytes(data))

        self.card = segment.connect("can", heard, lambda: None)
        if boot:
            self.wait(300)

    @property
    def drive(self) -> SimulatedDrive:
        return self.units[0]

    def wait(self, ms: float) -> None:
        self.clock.run_until_ns(self.clock.now_ns() + round(ms * MS))

    def send(self, identifier: int, data: bytes = b"", rtr: bool = False) -> None:
        self.card.receive_bytes(encode_frames(CanFrame(identifier, data, rtr=rtr)))

    def heard(self, identifier: int, since_ns: int = 0) -> list[bytes]:
        """Data of all frames with this identifier."""
        return [
            frame.data for at, frame in self.frames if frame.id == identifier and not frame.error and at >= since_ns
        ]

    def ask(self, data: bytes, node: int = 1, wait_ms: float = 3) -> list[bytes]:
        """The SDO server's answer to eight bytes."""
        begun_ns = self.clock.now_ns()
        self.send(0x600 + node, data)
        self.wait(wait_ms)
        return self.heard(0x580 + node, begun_ns)

    def read(self, index: int, sub: int = 0, node: int = 1, signed: bool = False) -> int:
        """Expedited upload. Raises `Aborted`."""
        (answer,) = self.ask(bytes([0x40, *index.to_bytes(2, "little"), sub, 0, 0, 0, 0]), node)
        _require_no_abort(answer)
        return int.from_bytes(answer[4 : 8 - (answer[0] >> 2 & 3)], "little", signed=signed)

    def write(self, index: int, sub: int, value: int, size: int, node: int = 1) -> None:
        """Expedited download. Raises `Aborted`."""
        data = (value % (1 << 8 * size)).to_bytes(size, "little").ljust(4, b"\0")
        head = 0x23 | (4 - size) << 2
        (answer,) = self.ask(bytes([head, *index.to_bytes(2, "little"), sub]) + data, node)
        _require_no_abort(answer)

    def control(self, word: int, node: int = 1, wait_ms: float = 1) -> int:
        """Write the controlword; the statusword after it."""
        self.write(0x6040, 0, word, 2, node)
        self.wait(wait_ms)
        return self.status(node)

    def status(self, node: int = 1) -> int:
        return self.read(0x6041, 0, node)

    def start(self, node: int = 0) -> None:
        """NMT start."""
        self.send(0, bytes([1, node]))
        self.wait(1)

    def enable(self, mode: int, node: int = 1) -> None:
        self.write(0x6060, 0, mode, 1, node)
        for word in (0x06, 0x07, 0x0F):
            self.control(word, node)
        assert self.status(node) & 0x6F == 0x27

    def map(self, receive: bool, number: int, objects: Sequence[int], kind: int, node: int = 1) -> int:
        """Map objects into a PDO and switch it on; its identifier."""
        base = (0x180, 0x280, 0x380, 0x480)[number - 1] + (0x80 if receive else 0) + node
        parameter, mapping = (0x1400, 0x1600) if receive else (0x1800, 0x1A00)
        parameter, mapping = parameter + number - 1, mapping + number - 1
        self.write(parameter, 1, 0x80000000 | base, 4, node)
        self.write(parameter, 2, kind, 1, node)
        self.write(mapping, 0, 0, 1, node)
        for sub, each in enumerate(objects, 1):
            self.write(mapping, sub, each, 4, node)
        self.write(mapping, 0, len(objects), 1, node)
        self.write(parameter, 1, base, 4, node)
        return base


def _require_no_abort(answer: bytes) -> None:
    if answer[0] == 0x80:
        raise Aborted(int.from_bytes(answer[4:8], "little"))
