"""CAN frames and the bus in memory: bit times, arbitration, errors, bus-off."""

from random import Random

import pytest

from orchestrator.clock.queue import EventQueue
from orchestrator.link.can import (
    ERROR_BUS_OFF,
    ERROR_NO_ACKNOWLEDGE,
    ERROR_PASSIVE,
    ERROR_RESTARTED,
    CanFrame,
    FrameReader,
    decode_frames,
    encode_frames,
    frame_ns,
    longest_bits,
)
from orchestrator.link.can_bus import CanNode, MemoryCanBus, exact_bits, stuffable_bits

BIT_NS = 1000
FRAMES = (
    CanFrame(0x080),
    CanFrame(0x7FF, bytes(8)),
    CanFrame(0x185, b"\x27\x06\xff\xff"),
    CanFrame(0x1FFFFFFF, b"\x55\xaa", extended=True),
    CanFrame(0x705, b"\0", rtr=True),
    CanFrame(0x40, bytes(8), error=True),
)


class Bench:
    """A bus of 1 Mbit/s with nodes whose frames and faults are recorded."""

    def __init__(self, count: int = 3, **more: float) -> None:
        self.clock = EventQueue()
        self.bus = MemoryCanBus(self.clock, 1_000_000, seed=7, **more)
        self.heard: list[list[tuple[int, CanFrame]]] = [[] for _ in range(count)]
        self.troubles: list[list[int]] = [[] for _ in range(count)]
        self.sent: list[tuple[CanFrame, int, int]] = []
        self.bus.add_listener(lambda *each: self.sent.append(each))
        self.nodes = [self._attach(place) for place in range(count)]

    def _attach(self, place: int) -> CanNode:
        return self.bus.attach_node(
            lambda frame: self.heard[place].append((self.clock.now_ns(), frame)), self.troubles[place].append
        )

    def wait(self, ms: float) -> None:
        self.clock.run_until_ns(self.clock.now_ns() + round(ms * 1e6))


@pytest.mark.parametrize("frame", FRAMES, ids=str)
def test_frames_survive_their_bytes(frame: CanFrame) -> None:
    assert decode_frames(encode_frames(frame)) == [frame]
    reader = FrameReader()
    found = [each for byte in encode_frames(frame, frame) for each in reader.add_bytes(bytes([byte]))]
    assert found == [frame, frame]


def test_a_frame_is_the_kernels_struct() -> None:
    assert encode_frames(CanFrame(0x123, b"\x01\x02")) == bytes.fromhex("23010000 02000000 0102000000000000")
    assert encode_frames(CanFrame(0x123, extended=True))[:4] == bytes.fromhex("23010080")
    with pytest.raises(ValueError, match="17 bytes"):
        decode_frames(bytes(17))


@pytest.mark.parametrize(("identifier", "data"), [(0x800, b""), (-1, b""), (1, bytes(9))])
def test_an_invalid_frame_is_refused(identifier: int, data: bytes) -> None:
    with pytest.raises(ValueError, match="CAN"):
        CanFrame(identifier, data)


def test_bits_of_a_frame() -> None:
    # 8 bytes: 34 + 64 bits that can be stuffed, up to 24 stuff bits, and 13 after them: 135 at the most.
    assert longest_bits(CanFrame(1, bytes(8))) == 135
    assert longest_bits(CanFrame(1, bytes(8), extended=True)) == 160
    assert longest_bits(CanFrame(1, bytes(8), rtr=True)) == longest_bits(CanFrame(1))
    assert frame_ns(CanFrame(1, bytes(8)), 500_000) == 270_000


def plainly(bits: str) -> int:
    """Stuff bits, one bit after another as in the standard."""
    stuffed, run, last = 0, 0, ""
    for bit in bits:
        run = run + 1 if bit == last else 1
        last = bit
        if run == 5:
            stuffed, run, last = stuffed + 1, 1, "10"[int(bit)]
    return stuffed


def remainder(bits: str) -> int:
    """The CRC, one bit after another as in the standard."""
    crc = 0
    for bit in bits:
        carry = crc >> 14 ^ int(bit)
        crc = (crc << 1 & 0x7FFF) ^ (0x4599 if carry else 0)
    return crc


def test_stuff_bits_and_crc_are_those_of_the_standard() -> None:
    draw = Random(11)
    for _ in range(2000):
        extended = draw.random() < 0.3
        identifier = draw.getrandbits(29 if extended else 11) & draw.getrandbits(29)
        data = bytes(draw.choice((0, 0xFF, draw.getrandbits(8))) for _ in range(draw.randrange(9)))
        frame = CanFrame(identifier, data, extended, draw.random() < 0.1)
        bits = stuffable_bits(frame)
        payload = 0 if frame.rtr else 8 * len(data)
        assert len(bits) == (54 if extended else 34) + payload
        assert remainder(bits) == 0  # once more over a frame with its CRC appended
        assert exact_bits(frame) == len(bits) + plainly(bits) + 13
        assert exact_bits(frame) <= longest_bits(frame)


def test_the_bits_of_a_sync() -> None:
    bits = stuffable_bits(CanFrame(0x080))
    # start of frame, identifier, RTR, IDE, reserved, length
    assert bits[:19] == "0" + "00010000000" + "0" + "0" + "0" + "0000"


def test_a_frame_takes_its_bit_time_and_reaches_every_other_node() -> None:
    bench = Bench()
    frame = CanFrame(0x123, b"\x01\x02\x03")
    bench.nodes[0].queue_frames(frame)
    bench.wait(1)
    end_ns = (exact_bits(frame) - 3) * BIT_NS
    assert bench.heard == [[], [(end_ns, frame)], [(end_ns, frame)]]
    assert bench.sent == [(frame, 0, end_ns)]
    assert bench.bus.busy_ns == exact_bits(frame) * BIT_NS


def test_the_lowest_identifier_wins_and_a_sender_keeps_its_order() -> None:
    bench = Bench()
    bench.nodes[0].queue_frames(CanFrame(0x300), CanFrame(0x100))
    bench.nodes[1].queue_frames(CanFrame(0x200))
    bench.nodes[2].queue_frames(CanFrame(0x200 << 18, extended=True), CanFrame(0x081))
    bench.wait(2)
    # Standard before extended with the same first bits; node 0 keeps 0x100 after 0x300, which waits for all others.
    assert [frame.id for frame, _, _ in bench.sent] == [0x200, 0x200 << 18, 0x081, 0x300, 0x100]
    begins = [begin for _, begin, _ in bench.sent]
    ends = [end for _, _, end in bench.sent]
    assert [after - before for before, after in zip(ends, begins[1:], strict=False)] == [3 * BIT_NS] * 4


def test_a_node_that_sorts_by_identifier_sends_the_lowest_first() -> None:
    bench = Bench(2)
    node = bench.bus.attach_node(lambda frame: None, by_identifier=True)
    node.queue_frames(CanFrame(0x300), CanFrame(0x100), CanFrame(0x200))
    bench.wait(2)
    assert [frame.id for frame, _, _ in bench.sent] == [0x100, 0x200, 0x300]


def test_a_destroyed_frame_is_sent_again_and_counted() -> None:
    bench = Bench()
    bench.bus.disturb_frames(3)
    bench.nodes[0].queue_frames(CanFrame(0x123))
    bench.wait(2)
    assert len(bench.sent) == 1
    assert bench.nodes[0].transmit_errors == 3 * 8 - 1
    assert bench.nodes[1].receive_errors == 3 - 1


def test_a_burst_of_error_frames_takes_the_sender_off_the_bus_and_a_restart_brings_it_back() -> None:
    bench = Bench()
    bench.bus.disturb_frames(32)
    bench.nodes[0].queue_frames(CanFrame(0x123))
    bench.wait(5)
    assert bench.nodes[0].node_state == "off"
    assert bench.nodes[1].node_state == "active"
    assert [each for each in bench.troubles[0] if each in (ERROR_PASSIVE, ERROR_BUS_OFF)] == [
        ERROR_PASSIVE,
        ERROR_BUS_OFF,
    ]
    bench.nodes[0].queue_frames(CanFrame(0x124))
    bench.nodes[0].leave_bus_off()
    bench.wait(1.3)
    assert bench.nodes[0].node_state == "off"
    bench.wait(0.2)
    assert bench.nodes[0].node_state == "active"
    assert bench.troubles[0][-1] == ERROR_RESTARTED
    bench.nodes[0].queue_frames(CanFrame(0x125))
    bench.wait(1)
    assert [frame.id for _, frame in bench.heard[1]] == [0x125]


def test_a_node_alone_on_a_bus_becomes_passive_and_waits_for_another() -> None:
    bench = Bench(1)
    bench.nodes[0].queue_frames(CanFrame(0x123))
    bench.wait(50)
    assert bench.nodes[0].node_state == "passive"
    assert bench.nodes[0].transmit_errors == 128
    assert bench.troubles[0][-1] == ERROR_NO_ACKNOWLEDGE
    heard: list[CanFrame] = []
    bench.bus.attach_node(heard.append)
    bench.wait(1)
    assert [frame.id for frame in heard] == [0x123]


@pytest.mark.parametrize("after_us", range(0, 3000, 25))
def test_a_node_that_appears_at_any_instant_of_the_retries_receives_the_frame(after_us: int) -> None:
    # Also in the very frame after which a passive node without a partner gives up: in its last retry before that.
    bench = Bench(1)
    bench.nodes[0].queue_frames(CanFrame(0x123))
    bench.wait(after_us / 1000)
    received: list[CanFrame] = []
    bench.bus.attach_node(received.append)
    bench.wait(2)
    assert [frame.id for frame in received] == [0x123]


def test_a_broken_wire_separates_all_nodes() -> None:
    bench = Bench()
    bench.bus.cut = True
    bench.nodes[0].queue_frames(CanFrame(0x123))
    bench.wait(20)
    assert bench.heard == [[], [], []]
    bench.bus.cut = False
    bench.bus.retry_frames()
    bench.wait(1)
    assert len(bench.heard[1]) == 1


def test_a_node_of_another_bit_rate_receives_nothing_and_destroys_what_it_sends() -> None:
    bench = Bench(2)
    heard: list[CanFrame] = []
    wrong = bench.bus.attach_node(heard.append, bitrate=500_000)
    bench.nodes[0].queue_frames(CanFrame(0x123))
    bench.wait(1)
    assert (len(bench.heard[1]), heard) == (1, [])
    wrong.queue_frames(CanFrame(0x200))
    bench.wait(20)
    assert wrong.node_state == "off"
    assert len(bench.heard[1]) == 1


def test_two_nodes_with_one_identifier_and_different_data_destroy_each_other() -> None:
    bench = Bench()
    bench.nodes[0].queue_frames(CanFrame(0x181, b"\x01"))
    bench.nodes[1].queue_frames(CanFrame(0x181, b"\x02"))
    bench.wait(20)
    assert [node.node_state for node in bench.nodes] == ["off", "off", "active"]
    assert bench.sent == []


def test_errors_come_by_chance_from_the_seed_alone() -> None:
    def run() -> list[tuple[CanFrame, int, int]]:
        bench = Bench(error_rate=0.05)
        for number in range(200):
            bench.nodes[number % 3].queue_frames(CanFrame(0x100 + number, bytes([number])))
            bench.wait(0.5)
        return bench.sent

    once = run()
    assert once == run()
    assert len(once) == 200
    late = [begin for frame, begin, _ in once if begin != (frame.id - 0x100) * 500_000]
    assert 2 < len(late) < 25


def test_a_node_that_loses_power_spoils_its_frame() -> None:
    bench = Bench()
    bench.nodes[0].queue_frames(CanFrame(0x123, bytes(8)))
    bench.wait(0.05)
    bench.nodes[0].set_connected(connected=False)
    bench.wait(1)
    assert bench.heard == [[], [], []]
    bench.nodes[0].queue_frames(CanFrame(0x124))
    bench.wait(1)
    assert bench.sent == []
