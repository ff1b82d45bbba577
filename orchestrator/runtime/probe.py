"""One query to a controller that Tutti may not know: the bytes, and when they came."""

import asyncio
import re
from collections.abc import Sequence
from dataclasses import dataclass

from adapters.link.open import make_link_opener
from orchestrator.clock.base import NS_PER_S
from orchestrator.clock.live import LiveClock
from orchestrator.link.base import Link, LinkClosed
from orchestrator.model.errors import TuttiError
from orchestrator.model.links import SerialLink, TcpLink, UdpLink

MOST_BYTES = 100_000
_NETWORK = re.compile(r"(tcp|udp):(.+):(\d{1,5})")
_SERIAL = re.compile(r"(?:serial:)?(/[^,]+|COM\d+)(?:,(\d+)(?:,([78])([NEO])([12]))?)?")
_EXAMPLES = "tcp:192.168.1.20:23, /dev/ttyUSB0,115200 or /dev/ttyS0,9600,7O1"
_PARITIES = {"N": "none", "E": "even", "O": "odd"}
_ESCAPE = re.compile(r"\\(x[0-9a-fA-F]{2}|[rnt0\\])")
_ESCAPED = {"r": "\r", "n": "\n", "t": "\t", "0": "\0", "\\": "\\"}


class BadProbe(TuttiError, ValueError):
    """An endpoint or a query that cannot be used."""


@dataclass(frozen=True, slots=True)
class ProbePart:
    """Bytes that were received together. after_ns: since the query was written."""

    after_ns: int
    data: bytes


def parse_probe_endpoint(text: str) -> TcpLink | UdpLink | SerialLink:
    """Return the link of an endpoint: `tcp:HOST:PORT`, `udp:HOST:PORT`, `/dev/ttyUSB0`, `/dev/ttyUSB0,9600`,
    `/dev/ttyUSB0,9600,7O1`. Raises `BadProbe`."""
    match = _NETWORK.fullmatch(text)
    if match is not None and 0 < int(match[3]) < 65536:
        kind = TcpLink if match[1] == "tcp" else UdpLink
        return kind.model_validate({"kind": match[1], "host": match[2], "port": int(match[3])})
    serial = _SERIAL.fullmatch(text)
    if serial is None:
        raise BadProbe(f"{text[:80]!r} is no endpoint, such as {_EXAMPLES}")
    frame = {}
    if serial[3]:
        frame = {"data_bits": int(serial[3]), "parity": _PARITIES[serial[4]], "stop_bits": int(serial[5])}
    try:
        return SerialLink.model_validate(
            {"kind": "serial", "device": serial[1], "baud": int(serial[2] or 115_200), **frame}
        )
    except ValueError as error:
        raise BadProbe(f"{text[:80]!r} is no endpoint: {error}") from None


def parse_probe_query(text: str) -> bytes:
    """Return the bytes of a query with the escapes \\r, \\n, \\t, \\0, \\\\ and \\x18. Raises `BadProbe`."""

    def unescape(found: "re.Match[str]") -> str:
        return chr(int(found[1][1:], 16)) if found[1][0] == "x" else _ESCAPED[found[1]]

    remainder = _ESCAPE.sub("", text)
    if "\\" in remainder:
        raise BadProbe(f"{text[:80]!r}: unknown escape; known are \\r, \\n, \\t, \\0, \\\\ and \\x18")
    try:
        return _ESCAPE.sub(unescape, text).encode("latin-1")
    except UnicodeEncodeError:
        raise BadProbe(f"{text[:80]!r}: write bytes beyond 7F as \\xB5") from None


async def probe_controller(
    endpoint: TcpLink | UdpLink | SerialLink, query: bytes, wait_s: float
) -> Sequence[ProbePart]:
    """Write the query and return what comes within `wait_s`, at most 100 kB. Raises `LinkRefused`, `LinkClosed`."""
    clock = LiveClock()
    link = await make_link_opener(endpoint, clock)()
    parts: list[ProbePart] = []
    try:
        written_ns = link.write(query)
        await _collect(link, parts, written_ns, wait_s)
    finally:
        await link.close()
    return parts


async def _collect(link: Link, parts: list[ProbePart], written_ns: int, wait_s: float) -> None:
    size = 0
    try:
        async with asyncio.timeout(wait_s):
            while size < MOST_BYTES:
                received_bytes = await link.read()
                parts.append(ProbePart(received_bytes.at_ns - written_ns, received_bytes.data))
                size += len(received_bytes.data)
    except TimeoutError:
        return
    except LinkClosed:
        if not parts:
            raise


def format_after(after_ns: int) -> str:
    """Return a time for people."""
    return f"{after_ns * 1000 / NS_PER_S:.3f} ms"
