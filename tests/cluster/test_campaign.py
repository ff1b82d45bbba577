"""The fault campaign: every fault at every stage once, on fleets of all makes, without a violation."""

from collections import Counter

import pytest

from orchestrator.campaign.faults import FAULTS
from orchestrator.campaign.fleets import MAKES
from orchestrator.campaign.recorder import STAGES
from orchestrator.campaign.runs import ACTS, CELLS, PAIRS, ROUND, cells_of, run_campaign
from orchestrator.campaign.scenario import ALONE, Cell, play

CHUNK = 5
SEEDS = -(-PAIRS // (ACTS * CHUNK)) * CHUNK


def cells_here(seed: int) -> list[Cell]:
    return [ROUND[seed + SEEDS * act] for act in range(ACTS)]


@pytest.mark.parametrize("first", range(0, SEEDS, CHUNK))
def test_no_seed_violates_an_invariant(first: int) -> None:
    hits = 0
    for seed in range(first, first + CHUNK):
        story = play(seed, cells_here(seed))
        assert not story.violations, story.tell()
        assert len(story.fleet.controllers) >= 4 and story.jobs > ACTS
        hits += len(story.hit)
    # A fault can come too late, when what broke before has left nothing of its step.
    assert hits >= CHUNK * (ACTS - 1)


@pytest.mark.parametrize("seed", [885, 993, 2712, 3173, 8093, 51175, 52181, 53295, 54477])
def test_seeds_that_found_something_do_not_find_it_again(seed: int) -> None:
    story = play(seed, cells_of(seed))
    assert not story.violations, story.tell()


def test_here_everything_breaks_at_every_stage() -> None:
    cells = [cell for seed in range(SEEDS) for cell in cells_here(seed)]
    assert {(cell.stage, cell.fault) for cell in cells} == {(stage, fault) for stage in STAGES for fault in FAULTS}
    assert {cell.make for cell in cells} == set(MAKES)


def test_what_a_campaign_found_is_counted() -> None:
    found = run_campaign([2])
    assert (found.seeds, len(found.controllers), len(found.jobs)) == (1, 1, 1) and not found.violations
    assert sum(found.cells.values()) >= sum(found.faults) == ACTS
    assert len(found.missed) + len(found.cells) == len(CELLS) and found.least == 0


def test_a_round_has_every_cell_of_a_member_and_pairs_change_with_rounds() -> None:
    times = Counter(ROUND)
    assert set(ROUND) <= set(CELLS)
    of_all = {cell for cell in CELLS if FAULTS[cell.fault].reach == "fleet" and cell.stage not in ALONE}
    assert {cell: times[cell] for cell in set(CELLS) - of_all} == dict.fromkeys(set(CELLS) - of_all, 3)
    # Each counts for all makes that take part in its step.
    assert {times[cell] for cell in of_all} == {2}
    assert len({(cell.stage, cell.fault) for cell in ROUND[:PAIRS]}) == PAIRS
    assert cells_of(3)[0] == cells_of(3 + len(ROUND))[0] and cells_of(3)[1] != cells_of(3 + len(ROUND))[1]


def test_a_seed_plays_the_same_again() -> None:
    cells = (Cell("arm", "host-killed", "shrc203"),)
    first, again = play(17, cells), play(17, cells)
    assert first.lines == again.lines
    assert (first.hit, first.events, first.fleet) == (again.hit, again.events, again.fleet)


def test_the_same_fault_may_befall_a_seed_twice() -> None:
    estop = next(cell for cell in CELLS if cell.fault == "estop" and cell.stage == "arm")
    story = play(3, [estop, estop])
    assert not story.violations, story.tell()
