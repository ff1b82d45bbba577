"""Traces of a virtual fleet of all makes: served in parts, and every frame has its words."""

import asyncio
from random import Random
from typing import NamedTuple

import pytest
from cluster.worlds import job, outcome, run_fleet

from adapters.cia402.decoder import Cia402Decoder
from adapters.cia402.options import Cia402Options
from adapters.host.makes import apply_make_defaults, find_decoder, known_makes
from adapters.toolkit.frames import DecodedFrame, FrameDirection, LineCutter, TextDecoder
from orchestrator.bus.base import RequestRefused
from orchestrator.link.can import CanFrame, encode_frames
from orchestrator.link.trace import TraceRing
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import parse_document
from orchestrator.model.messages import MAX_TRACE_PART, TracePart, TraceReply
from orchestrator.runtime.example_fleet import MakeCount, make_example_fleet
from orchestrator.runtime.virtual.fleet import VirtualFleet

SHARED = ("smc30", "smc2000", "cia402")  # of these there are two on one line
MS = 1_000_000


class TracedRun(NamedTuple):
    """What a fleet of all makes has traced while its axes were homed. later: after the first one, and of the last
    seconds. part: one answer of an adapter; refused: why a request is not valid."""

    replies: dict[str, TraceReply]
    later: TraceReply
    last: TraceReply
    part: TracePart
    refused: str


def fleet_of_all_makes() -> Fleet:
    makes = [MakeCount(make, 2 if make in SHARED else 1) for make in known_makes()]
    text = make_example_fleet(makes, "all", "all.fleet.yaml")
    return apply_make_defaults(parse_document(text, Fleet, "all.fleet.yaml"))


@pytest.fixture(scope="module")
def run() -> TracedRun:
    async def main(fleet: VirtualFleet) -> TracedRun:
        names = ", ".join(fleet.fleet.controllers)
        report = await outcome(fleet, job(f"[{{do: enable, axes: [{names}]}}, {{do: home}}]"))
        assert report.state == "done", report.reason
        client = fleet.make_client()
        replies = {name: await client.read_trace(name) for name in fleet.fleet.controllers}
        first = replies["shrc203"]
        await asyncio.sleep(1)
        later = await client.read_trace("shrc203", after=first.newest)
        last = await client.read_trace("shrc203", last_s=2)
        key, request = fleet.keys.trace("shrc203"), b'{"request_id": "1", "actor": "me", "after_entry": 7, "limit": 5}'
        part = TracePart.model_validate_json(await client.bus.request(key, request, 1.0))
        try:
            await client.bus.request(key, request.replace(b": 5", b": 5000"), 1.0)
        except RequestRefused as error:
            return TracedRun(replies, later, last, part, str(error))
        raise AssertionError("not refused")

    return run_fleet(main, fleet_of_all_makes())


def decode(reply: TraceReply) -> list[tuple[str, DecodedFrame]]:
    decoder = find_decoder(reply.make, reply.options)
    return [
        (direction, frame)
        for _, direction, text in reply.entries
        for frame in decoder.decode_bytes(direction, text.encode("latin-1"))
    ]


# What is served


def test_a_long_trace_is_read_in_parts(run: TracedRun) -> None:
    reply = run.replies["cia402-1"]
    assert len(reply.entries) > 2 * MAX_TRACE_PART and reply.lost == 0
    assert reply.newest >= len(reply.entries)
    instants = [at_ns for at_ns, _, _ in reply.entries]
    assert instants == sorted(instants) and reply.host_ns >= instants[-1]


def test_a_trace_continues_after_what_is_known(run: TracedRun) -> None:
    first, later = run.replies["shrc203"], run.later
    assert later.entries and later.newest == first.newest + len(later.entries)
    assert later.entries[0][0] >= first.entries[-1][0]
    since_ns = run.last.host_ns - 2_000 * MS
    assert [each[0] for each in run.last.entries] == [
        at_ns for at_ns, _, _ in [*first.entries, *later.entries] if at_ns >= since_ns
    ][: len(run.last.entries)]
    assert 0 < len(run.last.entries) < len(first.entries)


def test_one_answer_is_bounded(run: TracedRun) -> None:
    assert [each.number for each in run.part.entries] == [8, 9, 10, 11, 12]
    assert run.part.newest > 12 and run.part.lost == 0
    assert "limit" in run.refused and "500" in run.refused


def test_entries_that_are_not_kept_are_counted() -> None:
    ring = TraceRing()
    for number in range(1, 6):
        ring.add_entry(number * 20_000 * MS, "out", bytes([number]))
    assert (ring.oldest, ring.newest) == (2, 5)
    assert [data for _, _, data in ring.entries_from(1, 2)] == [b"\x02", b"\x03"]
    assert ring.entries_from(6, 9) == []
    assert (ring.first_since(70_000 * MS), ring.first_since(101_000 * MS)) == (4, 6)
    # Bytes of another process are recorded afterwards: shown at their instant, and not skipped by a reader.
    ring.add_entry(90_000 * MS, "out", b"late")
    assert [data for _, _, data in ring.entries_from(6, 9)] == [b"late"]
    assert [data for _, _, data in ring.recent_entries()][-2:] == [b"late", b"\x05"]


# Words


def test_every_frame_of_every_make_has_its_words(run: TracedRun) -> None:
    assert {reply.make for reply in run.replies.values()} == set(known_makes())
    for name, reply in run.replies.items():
        frames = decode(reply)
        assert len(frames) > 300, (name, len(frames))
        unknown = {(direction, frame.text) for direction, frame in frames if not frame.meaning}
        assert not unknown, (name, len(unknown), sorted(unknown)[:20])


@pytest.mark.parametrize(
    ("name", "direction", "text", "meaning", "address"),
    [
        ("smc4000", "out", "QR AB", "ask data record", ""),
        ("smc4000", "in", "80 bytes", "data record of sample", ""),
        ("smc4000", "out", "SHX", "servo here", ""),
        ("galil", "in", ":", "accepted: CFS", ""),
        ("smc2000-1", "out", "%1", "select controller 1", "1"),
        ("smc2000-1", "in", "0, ", "program output", "0"),
        ("shrc203", "out", "Q:SPC", "ask coordinates and states", ""),
        ("shrc203", "in", "P", " ready, 2 at ", ""),
        ("ppsmc", "in", "1:13", "1 ready referenced idle", ""),
        ("smc30-1", "out", "V1", "ask position", "1"),
        ("smc30-1", "in", "V+", "answer to V1", "2"),
        ("cia402-1", "out", "000#0101", "NMT start: node 1", ""),
        ("cia402-1", "in", "581#4B4160", "SDO statusword (6041h:00) is ", "node 1"),
        ("cia402-2", "in", "182#", "TPDO 1 statusword", "node 2"),
        ("ascii", "out", "$H", "search the reference", ""),
        ("ascii", "in", "<Idle", "status: idle", ""),
    ],
)
def test_frames_have_the_words_of_their_manuals(
    run: TracedRun, name: str, direction: str, text: str, meaning: str, address: str
) -> None:
    frames = [frame for at, frame in decode(run.replies[name]) if at == direction and frame.text.startswith(text)]
    assert any(meaning in frame.meaning and frame.address == address for frame in frames), frames[:5]


def test_a_can_bus_is_decoded_by_service_and_object() -> None:
    decoder = Cia402Decoder(Cia402Options())
    for frame, meaning in (
        (CanFrame(0x080), "SYNC"),
        (CanFrame(0x083, bytes.fromhex("2081200000000000")), "EMCY CAN in error passive mode (8120h)"),
        (CanFrame(0x203, bytes.fromhex("1f00")), "RPDO 1 controlword 001Fh (enable operation, new set-point)"),
        (CanFrame(0x403, bytes.fromhex("e8030000d0070000")), "RPDO 3 target position 1000, profile velocity 2000"),
        (CanFrame(0x603, bytes.fromhex("2f60600001000000")), "SDO write modes of operation (6060h:00) = 1"),
        (CanFrame(0x583, bytes.fromhex("8000200000000206")), "SDO abort 2000h:00: object does not exist"),
        (CanFrame(0x703, b"\x7f"), "heartbeat: pre-operational"),
    ):
        (found,) = decoder.decode_bytes("in", encode_frames(frame))
        assert meaning in found.meaning, (found, meaning)


def test_a_frame_that_comes_in_pieces_is_one_frame(run: TracedRun) -> None:
    for name in ("shrc203", "smc4000", "smc2000-1", "smc30-1", "ppsmc", "cia402-1"):
        reply = run.replies[name]
        decoder = find_decoder(reply.make, reply.options)
        pieces = [
            frame
            for _, direction, text in reply.entries
            for byte in text.encode("latin-1")
            for frame in decoder.decode_bytes(direction, bytes([byte]))
        ]
        assert pieces == [frame for _, frame in decode(reply)], name


@pytest.mark.parametrize("make", [*known_makes(), "unknown"])
def test_no_bytes_make_a_decoder_raise(run: TracedRun, make: str) -> None:
    random = Random(7)
    options = next((reply.options for reply in run.replies.values() if reply.make == make), {})
    seen = next((reply.entries for reply in run.replies.values() if reply.make == make), [])
    decoder = find_decoder(make, options)
    assert isinstance(decoder, TextDecoder) or make != "unknown"
    directions: tuple[FrameDirection, FrameDirection] = ("out", "in")
    for _ in range(1500):
        data = random.randbytes(random.randrange(40))
        if seen and random.random() < 0.6:
            data = random.choice(seen)[2].encode("latin-1")
            data = data[: random.randrange(len(data) + 1)] + random.randbytes(random.randrange(3))
        for frame in decoder.decode_bytes(random.choice(directions), data):
            assert frame.text.isprintable() and frame.meaning.isprintable()


def test_bytes_without_an_end_are_not_kept() -> None:
    cutter = LineCutter()
    assert sum(len(line) for _ in range(50) for line in cutter.cut_lines(b"x" * 1000)) >= 46_000
