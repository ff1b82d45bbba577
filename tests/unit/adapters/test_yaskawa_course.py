"""Records of a path in chunks: what the controller plays is the path, whatever its clock does."""

from random import Random

import pytest

from adapters.contract import PathChunk
from adapters.yaskawa.shapes.course_records import (
    MOST_CORRECTION,
    BegunPath,
    ChunkRecords,
    RecordMaker,
    RingRoom,
    find_chunk_s,
    find_room,
)
from adapters.yaskawa.shapes.model import SMC4000
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.profile import Profile

TICK_NS, INTERVAL = 976_562.5, 3
RECORD_S = TICK_NS * 8 / 1e9
SPEED = 50_000.0  # counts/s
ROOM = RingRoom(512, 64)
SWITCH_S = 0.1
T0_NS, TICK = 5_000_000_000, 4000


def make_chunk(number: int, begin_s: float, end_s: float, *, last: bool = False) -> PathChunk:
    """Both axes at constant speed, x forward and y half as fast backward, then to rest within 0.2 s."""
    profiles = {}
    for name, speed in (("x", SPEED), ("y", -SPEED / 2)):
        end = round(speed * (end_s + 0.1))
        profiles[name] = Profile(
            0, end, 1.0, [end_s - begin_s, 0.2], [0.0, -speed / 0.2], [0.0, 0.0], speed * begin_s, speed
        )
    return PathChunk(number, begin_s, end_s, last, profiles)


def make_mapping(ppm: float) -> TickMapping:
    """A clock whose samples last `ppm` longer than nominal since T0."""
    tick_ns = TICK_NS * (1 + ppm * 1e-6)
    return TickMapping(TICK, T0_NS, tick_ns, ppm, 0, 1000, 1.0, 20, 0)


def make_maker() -> RecordMaker:
    return RecordMaker({"x": 0, "y": 1}, INTERVAL, ROOM, SMC4000)


class Ring:
    """The arrays of the controller, and what its program plays out of them."""

    def __init__(self) -> None:
        self.elements = {index: [0] * ROOM.elements for index in (0, 1)}

    def load(self, records: ChunkRecords) -> None:
        for part in records.parts:
            for index, values in part.values.items():
                self.elements[index][part.first : part.first + len(values)] = values

    def play(self, first: int, end: int) -> dict[int, int]:
        return {i: sum(each[n & ROOM.ring - 1] for n in range(first, end)) for i, each in self.elements.items()}

    def play_tail(self, records: ChunkRecords) -> dict[int, int]:
        variables = records.tail_variables(ROOM)
        return {i: sum(each[variables["XTB"] : variables["XM"]]) for i, each in self.elements.items()}


@pytest.mark.parametrize("ppm", [0.0, 90.0, -90.0])
def test_chunk_after_chunk_is_the_path_by_a_drifting_clock(ppm: float) -> None:
    maker, ring, begun = make_maker(), Ring(), BegunPath(TICK, T0_NS)
    records = maker.make_first(make_chunk(0, 0.0, 1.5), 0.0, TICK_NS)
    ring.load(records)
    assert records.first == 0 and records.fit.path_error_counts.keys() == {"x", "y"}
    at = ring.play(0, records.end)
    for number in range(1, 12):
        begin_s, end_s = 1.5 * number - SWITCH_S, 1.5 * (number + 1)
        following = maker.make_next(make_chunk(number, begin_s, end_s), records, make_mapping(ppm), begun)
        assert following.first == records.end and following.slot == 1 - records.slot
        assert abs(following.times.record_s / (RECORD_S * (1 + ppm * 1e-6)) - 1) <= MOST_CORRECTION * 1.001
        # What still could happen: it brakes where it was to be continued.
        stopped = {index: at[index] + way for index, way in ring.play_tail(records).items()}
        assert stopped == records.targets
        ring.load(following)
        assert {index: at[index] + way for index, way in ring.play_tail(records).items()} == stopped
        played = ring.play(following.first, following.end)
        at = {index: at[index] + played[index] for index in at}
        records = following
        true_s = TICK_NS * (1 + ppm * 1e-6) * records.end * 8 / 1e9
        assert (
            abs(at[0] - SPEED * true_s) <= 1.0 + 40e-6 * SPEED
            and abs(at[1] + SPEED / 2 * true_s) <= 1.0 + 40e-6 * SPEED
        )
    assert abs(records.fit.left_ns) < 40_000 and abs(records.fit.drift_ns) <= 200_000


def test_a_chunk_is_cut_short_from_what_is_released() -> None:
    maker, begun, draw = make_maker(), BegunPath(TICK, T0_NS), Random(1)
    first = maker.make_first(make_chunk(0, 0.0, 1.5), 0.0, TICK_NS)
    second = maker.make_next(make_chunk(1, 1.4, 3.0), first, make_mapping(50.0), begun)
    for _ in range(20):
        end_s = draw.uniform(0.3, 2.9)
        cut = maker.make_next(make_chunk(2, end_s - SWITCH_S, end_s), second, make_mapping(50.0), begun)
        part = first if cut.end < second.first else second
        assert cut.end * RECORD_S == pytest.approx(end_s, abs=1.2 * RECORD_S) and len(cut.parts) == 1
        (tail,) = cut.parts
        for index, values in tail.values.items():
            assert part.counts[index][cut.end - part.first] + sum(values) == cut.targets[index]
    with pytest.raises(Refusal) as caught:
        maker.make_next(make_chunk(2, -0.2, 0.0), second, make_mapping(50.0), begun)
    assert caught.value.code == "late"


def test_the_last_chunk_ends_within_a_sample_of_its_plan() -> None:
    maker = make_maker()
    for duration_s in (0.5, 0.5031, 0.777, 1.2345):
        chunk = make_chunk(0, 0.0, duration_s, last=True)
        records = maker.make_first(chunk, 0.3, TICK_NS)
        ends_s = (records.samples(INTERVAL) + 0.3) * TICK_NS / 1e9
        assert -0.5 * TICK_NS / 1e9 <= ends_s - chunk.stop_s <= 2.5 * TICK_NS / 1e9
        ring = Ring()
        ring.load(records)
        both = ring.play(0, records.end), ring.play_tail(records)
        assert {index: both[0][index] + both[1][index] for index in (0, 1)} == records.targets


def test_a_gap_before_a_chunk_is_refused() -> None:
    maker = make_maker()
    first = maker.make_first(make_chunk(0, 0.0, 1.5), 0.0, TICK_NS)
    with pytest.raises(Refusal) as caught:
        maker.make_next(make_chunk(1, 1.7, 3.0), first, make_mapping(0.0), BegunPath(TICK, T0_NS))
    assert caught.value.code == "gap"


@pytest.mark.parametrize(("axes", "ring"), [(1, 2048), (2, 2048), (4, 2048), (8, 1024)])
def test_arrays_have_room_for_two_chunks_and_two_tails(axes: int, ring: int) -> None:
    room = find_room(15_000, axes, RECORD_S)
    assert room.ring == ring and axes * room.elements <= 15_000
    assert find_chunk_s(room, RECORD_S) == pytest.approx(7.5 if ring == 2048 else 508 * RECORD_S, abs=0.01)


def test_arrays_without_room_are_refused() -> None:
    with pytest.raises(Refusal) as caught:
        find_room(2000, 4, RECORD_S)
    assert caught.value.code == "array-space" and "array_elements" in caught.value.remedy
