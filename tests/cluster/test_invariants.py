"""Each member broken at each stage of a step, over many seeds: the invariants hold by the simulators' own truth."""

import pytest
from cluster.worlds import MOVE, PREPARE, demo_fleet

from adapters.member import Member
from adapters.shrc203.driver import ShrcDriver
from adapters.unit import Unit
from orchestrator.coordinator.motion import Motion
from orchestrator.lab.campaign import FAULTS, STAGES, Story, run_seed

CHUNK = 28
SEEDS = range(0, len(STAGES) * len(FAULTS), CHUNK)


def play(seed: int) -> Story:
    """Seeds walk through all pairs of stage and fault; what is random within a pair comes from the seed."""
    stage = STAGES[seed % len(STAGES)]
    fault = FAULTS[(seed // len(STAGES)) % len(FAULTS)]
    return run_seed(demo_fleet(), PREPARE, MOVE, seed, stage, fault)


@pytest.mark.parametrize("first", SEEDS)
def test_no_seed_violates_an_invariant(first: int) -> None:
    for seed in range(first, first + CHUNK):
        story = play(seed)
        assert not story.violations, story.tell()


# The judgement is worth something only if it notices when the code is broken.


def stories(stage: str, fault: str, count: int = 12) -> list[Story]:
    return [run_seed(demo_fleet(), PREPARE, MOVE, seed, stage, fault) for seed in range(count)]  # type: ignore[arg-type]


def test_a_coordinator_that_goes_without_promises_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Invariant 1: the decision is what lets axes move."""

    monkeypatch.setattr("orchestrator.coordinator.journal.Journal.decide", lambda *_: None)
    assert any("invariant 1/2" in v for story in stories("motion", "none", 1) for v in story.violations)


def test_a_member_that_is_not_stopped_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Invariant 3: when one member fails, the others stop."""

    async def does_nothing(*_: object) -> None:
        return None

    monkeypatch.setattr(Motion, "stop", does_nothing)
    monkeypatch.setattr(Unit, "_lease_ended", lambda *_: None)  # which would stop what the job has left moving
    assert any("invariant 3" in v for story in stories("motion", "limit", 2) for v in story.violations)


def test_evidence_that_claims_too_much_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Invariant 8: an interval that was narrowed to its earliest end misses the truth."""
    honest = ShrcDriver.started

    async def narrowed(self: ShrcDriver):  # type: ignore[no-untyped-def]
        return {axis: type(span)(span.earliest_ns, span.earliest_ns) for axis, span in (await honest(self)).items()}

    monkeypatch.setattr(ShrcDriver, "started", narrowed)
    assert any("invariant 8" in v for story in stories("motion", "none", 2) for v in story.violations)


def test_a_gate_that_is_always_open_is_noticed(monkeypatch: pytest.MonkeyPatch) -> None:
    """Invariant 2: a member that opens its gate at arming starts although another one failed."""
    honest = Member.arm

    async def eager(self: Member, request):  # type: ignore[no-untyped-def]
        armed = await honest(self, request)
        if self._controller == "gantry":
            await self._driver.go()
        return armed

    monkeypatch.setattr(Member, "arm", eager)
    monkeypatch.setattr(Motion, "_disarm", lambda *_: _nothing())
    monkeypatch.setattr(Unit, "_lease_ended", lambda *_: None)
    found = [v for story in stories("commit", "link-closed", 6) for v in story.violations]
    assert any("invariant 1/2" in v for v in found), found


async def _nothing() -> None:
    return None
