"""Which jobs may start: the rule of the queue, by itself."""

from random import Random

import pytest
from unit.random_rounds import share_with_nightly

from orchestrator.coordinator.jobs.needs import find_needed_controllers
from orchestrator.coordinator.jobs.queue.queue_order import (
    WITHOUT_AXES_REASON,
    QueueLimits,
    WaitingJob,
    choose_jobs,
    sort_waiting,
)
from orchestrator.coordinator.journal.records import JobRecord
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import parse_document
from orchestrator.model.jobs.job import Job

JOB = parse_document("schema: tutti.job/1\nname: test\nsteps: [{do: dwell, duration: 1 s}]\n", Job, "test")


def waiting(name: str, place: int, priority: int = 0, **fields: object) -> WaitingJob:
    row = JobRecord(
        id=name,
        name="scan",
        actor="anna",
        state="queued",
        reason="submitted",
        submitted_utc="2026-11-21T10:00:00.000000Z",
        priority=priority,
        place=place,
        repeat=1,
        after=None,
        at_utc=None,
        missed="skip",
        due=True,
        held_by="",
        origin=None,
        from_step=0,
    )
    return WaitingJob(row._replace(**fields), JOB)  # type: ignore[arg-type]


def ids(begin: list[WaitingJob]) -> list[str]:
    return [each.row.id for each in begin]


def test_resources_that_an_earlier_job_waits_for_are_reserved_for_it() -> None:
    a, b, c, d = (waiting(name, place) for place, name in enumerate("abcd"))
    queue = [(a, {"x", "y"}), (b, {"y"}), (c, {"z"}), (d, set[str]())]
    choice = choose_jobs([(each, frozenset(needs)) for each, needs in queue], {"x": "in use by ben (alignment)"})
    assert ids(choice.begin) == ["c", "d"]
    assert choice.reasons == {
        "a": "waits for x: in use by ben (alignment)",
        "b": "waits for y: job 'scan' a of anna comes first",
    }


def test_a_held_job_blocks_no_other() -> None:
    held, timed, late = waiting("a", 0, held_by="ben"), waiting("b", 1, due=False, at_utc="10:00"), waiting("c", 2)
    after = waiting("d", 3)
    after.pending = "q"
    choice = choose_jobs([(each, frozenset("x")) for each in (held, timed, after, late)], {})
    assert ids(choice.begin) == ["c"]
    assert choice.reasons == {"a": "held by ben", "b": "begins at 10:00", "d": "begins when job q is done"}


def test_jobs_without_axes_begin_only_in_free_places() -> None:
    a, b, c, d = (waiting(name, place) for place, name in enumerate("abcd"))
    queue = [(a, frozenset[str]()), (b, frozenset("x")), (c, frozenset[str]()), (d, frozenset[str]())]
    choice = choose_jobs(queue, {}, limits=QueueLimits(free_places=2))
    assert ids(choice.begin) == ["a", "b", "c"]
    assert choice.reasons == {"d": WITHOUT_AXES_REASON}


def test_priority_comes_before_place() -> None:
    queue = {each.row.id: each for each in (waiting("a", 1), waiting("b", 2, 1), waiting("c", 0), waiting("d", 3, -1))}
    assert ids(sort_waiting(queue)) == ["b", "c", "a", "d"]


@pytest.mark.parametrize("first", share_with_nightly(range(0, 300, 100), 1))
def test_no_seed_lets_a_job_overtake_or_two_share_a_controller_or_one_starve(first: int) -> None:
    for seed in range(first, first + 100):
        draw = Random(seed)
        controllers = "vwxyz"[: draw.randint(1, 5)]
        queue: list[tuple[WaitingJob, frozenset[str]]] = []
        running: dict[str, frozenset[str]] = {}
        begun: list[str] = []
        for turn in range(60):
            if turn < 40:
                needs = frozenset(draw.sample(controllers, draw.randint(0, len(controllers))))
                queue.append((waiting(str(turn), turn), needs))
            for name in list(running):
                if draw.random() < 0.3:
                    del running[name]
            busy = {each: name for name, needs in running.items() for each in needs}
            choice = choose_jobs(queue, busy)
            starts = set(ids(choice.begin))
            for place, (each, needs) in enumerate(queue):
                assert (each.row.id in starts) != (each.row.id in choice.reasons)
                if each.row.id in starts:
                    assert not needs & busy.keys()
                    assert not any(needs & before for _, before in queue[:place]), seed
                else:
                    assert needs & (busy.keys() | {c for _, before in queue[:place] for c in before})
            running |= {each.row.id: needs for each, needs in queue if each.row.id in starts}
            begun += ids(choice.begin)
            queue = [(each, needs) for each, needs in queue if each.row.id not in starts]
        while queue:
            choice = choose_jobs(queue, {})
            assert choice.begin, "the first one can always begin when nothing runs"
            begun += ids(choice.begin)
            queue = [(each, needs) for each, needs in queue if each not in choice.begin]
        assert sorted(begun, key=int) == [str(turn) for turn in range(40)]


def test_a_wire_that_may_start_a_step_belongs_to_one_job() -> None:
    fleet = parse_document(
        """
schema: tutti.fleet/1
fleet: wired
controllers:
  a: {adapter: smc4000, link: {kind: tcp, host: h, port: 1}, outputs: {go: {number: 1}}, axes: {x: &axis {motors: [X],
      unit: mm, scale: 1000, limits: {velocity: 1, acceleration: 1}}}}
  b: {adapter: smc4000, link: {kind: tcp, host: h, port: 2}, inputs: {go: {number: 1}}, axes: {x: *axis}}
  c: {adapter: smc4000, link: {kind: tcp, host: h, port: 3}, axes: {x: *axis}}
wiring: [{from: a.go, to: [b.go]}]
""",
        Fleet,
        "test",
    )

    def needs(steps: str) -> set[str]:
        return set(
            find_needed_controllers(
                fleet, parse_document(f"schema: tutti.job/1\nname: t\nsteps: {steps}\n", Job, "test").steps
            )
        )

    assert needs("[{do: move, to: {b.x: 1}}]") == {"a", "b"}
    assert needs("[{do: move, to: {a.x: 1, c.x: 1}}]") == {"a", "c"}
    assert needs("[{do: output, output: a.go, value: true}]") == {"a"}
    assert needs("[{do: home, axes: [b]}, {do: dwell, duration: 1 s}]") == {"b"}
    assert needs("[{do: home}]") == {"a", "b", "c"}
