"""The loops of scripts, by make: the one of this benchmark, which is the quickest, and those of the field.

Of the field are loops of public drivers, written here anew in the shape of theirs (what is sent, how the end is asked
for, how often), with the source; where there is none, the procedure of the maker's manual, with its lines.
"""

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass

from orchestrator.bench.naive import ScriptLoop, ScriptPort
from orchestrator.clock.base import NS_PER_MS
from orchestrator.link.can import CanFrame, CanLink

OURS = "ours"
_OURS_SOURCE = "of this benchmark: send, begin, query every millisecond"


@dataclass(frozen=True, slots=True)
class LineScript:
    """A loop of text lines.

    setup: lines at the beginning. begin: lines of a move to `{target}` counts. queries: lines that ask for the end;
    rests: what the reply to the last of them contains at rest. make_line: the bytes of a line for the controller with
    an address. ends: the end of any reply. is_answered: whether a line has a reply at all.
    """

    name: str
    source: str
    setup: tuple[str, ...]
    begin: tuple[str, ...]
    queries: tuple[str, ...]
    rests: re.Pattern[bytes]
    make_line: Callable[[str, int | None], bytes]
    ends: bytes
    pause_ns: int = NS_PER_MS
    settle_ns: int = 0
    is_answered: Callable[[str], bool] = lambda _: True

    async def set_up(self, port: ScriptPort, address: int | None) -> None:
        for text in self.setup:
            await self._ask(port, address, text)

    async def begin_move(self, port: ScriptPort, address: int | None, target: int) -> None:
        for text in self.begin:
            await self._ask(port, address, text.format(target=target))

    async def is_at_rest(self, port: ScriptPort, address: int | None) -> bool:
        reply = b""
        for text in self.queries:
            reply = await self._ask(port, address, text)
        return self.rests.search(reply) is not None

    async def _ask(self, port: ScriptPort, address: int | None, text: str) -> bytes:
        port.link.write(self.make_line(text, address))
        return await port.read_until(self.ends) if self.is_answered(text) else b""


def _end_with_cr(text: str, _: int | None) -> bytes:
    return text.encode() + b"\r"


def _end_with_crlf(text: str, _: int | None) -> bytes:
    return text.encode() + b"\r\n"


def _add_checksum(text: str, address: int | None) -> bytes:
    """The address, the line, and the sum of their codes (SMC30, L1066-1081)."""
    line = f"{'' if address is None else address}{text}".encode()
    return line + bytes([sum(line) % 128]) + b"\r"


def _make_smc4000(name: str, source: str, query: str, rests: bytes, pause_ns: int) -> LineScript:
    return LineScript(
        name,
        source,
        setup=("EO 0", "SHX", "SPX=200000", "ACX=1000000", "DCX=1000000"),
        begin=("PAX={target}", "BGX"),
        queries=(query,),
        rests=re.compile(rests),
        make_line=_end_with_cr,
        ends=b":",
        pause_ns=pause_ns,
    )


def _make_shrc203(name: str, source: str, query: str, rests: bytes, pause_ns: int) -> LineScript:
    return LineScript(
        name,
        source,
        setup=("C:11", "D:1S100F80000R200"),
        begin=("A:1+P{target}", "G:1"),
        queries=(query,),
        rests=re.compile(rests),
        make_line=_end_with_crlf,
        ends=b"\r\n",
        pause_ns=pause_ns,
    )


def _make_smc30(name: str, source: str, begin: tuple[str, ...]) -> LineScript:
    return LineScript(
        name,
        source,
        setup=("K", "S400", "T10000", "R1000", "CS1000", "CT1000", "CR1000"),
        begin=begin,
        queries=("F",),
        rests=re.compile(rb"^R"),
        make_line=_add_checksum,
        ends=b"\r",
    )


@dataclass(frozen=True, slots=True)
class _PpPolling:
    """How a script asks a pp-electronic SMC for the end; the last query is for its status."""

    queries: tuple[str, ...]
    pause_ns: int
    settle_ns: int = 0


def _make_ppsmc(name: str, source: str, begin: tuple[str, ...], polling: _PpPolling) -> LineScript:
    return LineScript(
        name,
        source,
        setup=("txdel3", "echo0", "frun1:4000", "ffast1:80000"),
        begin=begin,
        queries=polling.queries,
        rests=re.compile(rb"^1:\d*[13579];"),  # bit 0 of the status: ready
        make_line=_end_with_crlf,
        ends=b"\r\n",
        pause_ns=polling.pause_ns,
        settle_ns=polling.settle_ns,
        is_answered=lambda text: text.startswith("?"),
    )


_NEW_SET_POINT, _ACKNOWLEDGED, _REACHED = 1 << 4, 1 << 12, 1 << 10
_OPERATION_ENABLED = 0x0F
_CONTROLWORD, _STATUSWORD, _MODE, _TARGET = 0x6040, 0x6041, 0x6060, 0x607A
_PROFILE = {0x6081: 200_000, 0x6083: 1_000_000, 0x6084: 1_000_000}


@dataclass(frozen=True, slots=True)
class CanScript:
    """A loop of SDO transfers in profile position mode. reads_position: it reads 6064h behind each end."""

    name: str
    source: str
    pause_ns: int = NS_PER_MS
    settle_ns: int = 0
    waits_for_acknowledgement: bool = False
    bitrate: int = 1_000_000

    async def set_up(self, port: ScriptPort, address: int | None) -> None:
        can, node = CanLink(port.link, self.bitrate), address or 0
        can.send_frames(CanFrame(0, bytes([1, node])))
        await _write_object(can, node, _MODE, 1, 1)
        for index, value in _PROFILE.items():
            await _write_object(can, node, index, value, 4)
        for word in (0x06, 0x07, _OPERATION_ENABLED):
            await _write_object(can, node, _CONTROLWORD, word, 2)

    async def begin_move(self, port: ScriptPort, address: int | None, target: int) -> None:
        can, node = CanLink(port.link, self.bitrate), address or 0
        await _write_object(can, node, _TARGET, target, 4)
        await _write_object(can, node, _CONTROLWORD, _OPERATION_ENABLED | _NEW_SET_POINT, 2)
        if self.waits_for_acknowledgement:
            while not await _read_object(can, node, _STATUSWORD) & _ACKNOWLEDGED:
                pass
        await _write_object(can, node, _CONTROLWORD, _OPERATION_ENABLED, 2)

    async def is_at_rest(self, port: ScriptPort, address: int | None) -> bool:
        can = CanLink(port.link, self.bitrate)
        return bool(await _read_object(can, address or 0, _STATUSWORD) & _REACHED)


async def _write_object(can: CanLink, node: int, index: int, value: int, size: int) -> None:
    """Write an entry by SDO. size: bytes."""
    data = value.to_bytes(4, "little", signed=value < 0)
    await _transfer(can, node, bytes([0x23 | (4 - size) << 2]) + index.to_bytes(2, "little") + b"\0" + data)


async def _read_object(can: CanLink, node: int, index: int) -> int:
    reply = await _transfer(can, node, b"\x40" + index.to_bytes(2, "little") + bytes(5))
    return int.from_bytes(reply[4:8], "little")


async def _transfer(can: CanLink, node: int, request: bytes) -> bytes:
    can.send_frames(CanFrame(0x600 + node, request))
    while True:
        frame = (await can.read_frame()).frame
        if frame.id == 0x580 + node and frame.data[1:4] == request[1:4]:
            return frame.data


_EVERY_50_MS, _EVERY_100_MS = 50 * NS_PER_MS, 100 * NS_PER_MS

SCRIPTS: Mapping[str, tuple[ScriptLoop, ...]] = {
    "smc4000": (
        _make_smc4000(OURS, _OURS_SOURCE, "MG_BGX", rb"0\.0000\r\n:", NS_PER_MS),
        _make_smc4000(
            "telescope_control",
            "github.com/arikaplan/telescope_control, old/test.py: PR (here PA), BG, then MG _BG without a pause",
            "MG _BGX",
            rb"0\.0000\r\n:",
            0,
        ),
        _make_smc4000(
            "gclib",
            "Galil's gclib, gclibo.c, GMotionComplete: MG (_BGm=0) every 100 ms (POLLINGINTERVAL)",
            "MG (_BGX=0)",
            rb"1\.0000\r\n:",
            _EVERY_100_MS,
        ),
    ),
    "shrc203": (
        _make_shrc203(OURS, _OURS_SOURCE, "!:", rb"R\r\n", NS_PER_MS),
        _make_shrc203(
            "msl-equipment",
            "MSLNZ msl-equipment, OptoSigma SHOT-702, wait(): A:, G:, then Q: every 50 ms",
            "Q:",
            rb"R\r\n",
            _EVERY_50_MS,
        ),
        _make_shrc203(
            "PyOptoSigma",
            "github.com/ken1row/PyOptoSigma, move(): A:, G:, then !: every 2 s (wait_time)",
            "!:",
            rb"R\r\n",
            2000 * NS_PER_MS,
        ),
    ),
    "smc30": (
        _make_smc30(OURS, _OURS_SOURCE, ("G+{target}",)),
        _make_smc30(
            "manual",
            "no public driver found; the manual's session, L1373-1499: PO, the program, PX, E, then F (L1818-1827)",
            ("PO", "G+{target}", "PX", "E"),
        ),
    ),
    "ppsmc": (
        _make_ppsmc(OURS, _OURS_SOURCE, ("tbc", "tbs1:a{target}", "tbg"), _PpPolling(("?s",), NS_PER_MS)),
        _make_ppsmc(
            "EPICS SMC9300",
            "EPICS motor driver SMC9300Driver.cpp, move() and poll(): goto, then ?p, ?e, ?s every 100 ms (of its IOCs)",
            ("goto1:{target}",),
            _PpPolling(("?p1", "?e1", "?s1"), _EVERY_100_MS),
        ),
        _make_ppsmc(
            "egse huber",
            "ESA PLATO egse.stages.huber.smc9300 (E1 of the make's page): goto, 0.5 s, then ?s, here every 100 ms",
            ("goto1:{target}",),
            _PpPolling(("?s1",), _EVERY_100_MS, 500 * NS_PER_MS),
        ),
    ),
    "cia402": (
        CanScript(OURS, _OURS_SOURCE),
        CanScript(
            "Xeryon canopen",
            "Xeryon's examples with canopen, example_profile_position.py: 607Ah, 6040h bit 4, 6041h bit 12, "
            "6040h, then 6041h bit 10 every 1 ms, by SDO",
            waits_for_acknowledgement=True,
        ),
    ),
}
"""By adapter; the first one is that of this benchmark."""
