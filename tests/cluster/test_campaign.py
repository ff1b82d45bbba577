"""The fault campaign: every fault at every stage once, on fleets of all makes, without a violation."""

import pytest

from orchestrator.lab.campaign import Cell, Story, play
from orchestrator.lab.campaign_faults import FAULTS
from orchestrator.lab.campaign_fleets import MAKES
from orchestrator.lab.campaign_runs import CELLS, PAIRS, ROUND, cells_of, run_campaign
from orchestrator.lab.campaign_witness import STAGES

SEEDS, CHUNK = PAIRS // 2, 5


@pytest.mark.parametrize("first", range(0, SEEDS, CHUNK))
def test_no_seed_violates_an_invariant(first: int) -> None:
    def told(story: Story) -> None:
        assert not story.violations, story.tell()

    found = run_campaign(range(first, first + CHUNK), told)
    assert found.seeds == CHUNK
    # A fault can come too late, when what broke before has left nothing of its step.
    assert sum(found.faults) >= CHUNK
    assert min(found.controllers) >= 4 and min(found.jobs) >= 3


def test_the_first_seeds_break_everything_at_every_stage() -> None:
    broken = {(cell.stage, cell.fault) for seed in range(SEEDS) for cell in cells_of(seed)}
    assert broken == {(stage, fault) for stage in STAGES for fault in FAULTS}
    assert {cell.make for seed in range(SEEDS) for cell in cells_of(seed)} == set(MAKES)


def test_a_round_has_every_cell_of_a_member_and_pairs_change_with_rounds() -> None:
    assert len(ROUND) == len(set(ROUND)) and set(ROUND) <= set(CELLS)
    assert {cell for cell in CELLS if FAULTS[cell.fault].reach != "fleet"} <= set(ROUND)
    assert cells_of(3)[0] == cells_of(3 + len(ROUND))[0] and cells_of(3)[1] != cells_of(3 + len(ROUND))[1]


def test_a_seed_plays_the_same_again() -> None:
    cells = (Cell("arm", "host-killed", "shrc203"),)
    first, again = play(17, cells), play(17, cells)
    assert first.lines == again.lines
    assert (first.hit, first.events, first.fleet) == (again.hit, again.events, again.fleet)
