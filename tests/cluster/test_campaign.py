"""Fleets of all makes, broken at every stage: their seeds hold the invariants, and a seed plays the same again."""

import pytest

from orchestrator.lab.campaign import FAULTS, STAGES, Story
from orchestrator.lab.campaign_runs import play, run_campaign

CHUNK = 14


@pytest.mark.parametrize("first", range(0, 42, CHUNK))
def test_no_seed_violates_an_invariant(first: int) -> None:
    def told(story: Story) -> None:
        assert not story.violations, story.tell()

    found = run_campaign(range(first, first + CHUNK), told)
    assert found.seeds == CHUNK and sum(found.cells.values()) == CHUNK


def test_seeds_walk_through_every_stage_and_fault() -> None:
    pairs = {(seed % len(STAGES), seed // len(STAGES) % len(FAULTS)) for seed in range(len(STAGES) * len(FAULTS))}
    assert len(pairs) == len(STAGES) * len(FAULTS)


def test_a_seed_plays_the_same_again() -> None:
    first, again = play(17), play(17)
    assert first[0].lines == again[0].lines
    assert first[1] == again[1]
