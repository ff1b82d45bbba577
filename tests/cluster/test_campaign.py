"""The fault campaign: seeds directed at each stage, fault and make once; nightly at every fault at every stage."""

from collections import Counter
from typing import get_args

import pytest

from orchestrator.campaign.faults import FAULTS
from orchestrator.campaign.fleets import MAKES, TRIGGER_MAKE
from orchestrator.campaign.recording.recorder import STAGES, Stage
from orchestrator.campaign.runs import (
    CELLS,
    PAIRS,
    PHASES,
    ROUND,
    ROUND_FAULTS,
    SeedChoice,
    cells_of_seed,
    run_campaign,
)
from orchestrator.campaign.scenario import SINGLE_MEMBER_STAGES, FaultCell, run_scenario
from orchestrator.campaign.stages.hall import HALL_MAKE, HALL_STAGES
from orchestrator.cli.sim.campaign import STAGE_NAMES

IN_HALLS: list[tuple[Stage, str]] = [
    *(("fire", "host-killed"), ("propose", "load-late"), ("motion", "key-frames-lost")),
    *(("motion", "frame-lost"), ("commit", "frames-repeated"), ("chain", "frames-reordered")),
    *(("home", "frame-lost"), ("go", "coordinator-killed"), ("arm", "states-lost")),
]
"""Faults in fleets of 200 controllers; the first three in the suite, nightly all of them."""

DIRECTED = [
    FaultCell(STAGES[number % len(STAGES)], name, (fault.makes or MAKES)[number % len(fault.makes or MAKES)])
    for number, (name, fault) in enumerate(FAULTS.items())
    if (name not in {fault for _, fault in IN_HALLS} or name in ROUND_FAULTS) and not fault.of_databases
]
"""Each other fault once, with stages and makes in turn."""

OF_DATABASES: list[tuple[Stage, str]] = [
    *(("commit", "leader-machine-died"), ("motion", "primary-died")),
    *(("motion", "journal-slow"), ("go", "journal-lost"), ("chain", "leader-machine-died")),
]
"""Faults of a journal in databases on three machines; the first two in the suite, nightly all of them."""

CHUNK = 5
SEEDS = -(-PAIRS // (PHASES * CHUNK)) * CHUNK


def cells_here(seed: int) -> list[FaultCell]:
    return [ROUND[seed + SEEDS * act] for act in range(PHASES)]


@pytest.mark.parametrize("first", range(0, len(DIRECTED), PHASES))
def test_no_directed_seed_violates_an_invariant(first: int) -> None:
    cells = DIRECTED[first : first + PHASES]
    story = run_scenario(first, cells)
    assert not story.violations, story.summarize()
    assert len(story.fleet.controllers) >= 4 and story.jobs > len(cells)
    # A fault can come too late, when an earlier fault has already ended its step.
    assert len(story.hit) >= len(cells) - 1


@pytest.mark.parametrize("first", range(0, len(IN_HALLS), PHASES))
def test_no_directed_seed_of_a_hall_violates_an_invariant(first: int) -> None:
    cells = [FaultCell(stage, fault, HALL_MAKE) for stage, fault in IN_HALLS[first : first + PHASES]]
    story = run_scenario(first, cells)
    assert not story.violations, story.summarize()
    assert len(story.fleet.controllers) == 200 and len(story.hit) == len(cells)


@pytest.mark.nightly
@pytest.mark.parametrize("first", range(0, 40, 10))
def test_no_seed_of_a_hall_violates_an_invariant(first: int) -> None:
    choice = SeedChoice(hall=True)
    for seed in range(first, first + 10):
        story = run_scenario(seed, cells_of_seed(7 * seed, choice))  # stages and faults in turn
        assert not story.violations, story.summarize()


@pytest.mark.parametrize(
    "number", [0, 1, *(pytest.param(at, marks=pytest.mark.nightly) for at in range(2, len(OF_DATABASES)))]
)
def test_no_fault_of_a_journal_in_databases_violates_an_invariant(number: int) -> None:
    pytest.importorskip("psycopg")
    stage, fault = OF_DATABASES[number]
    story = run_scenario(number, [FaultCell(stage, fault, MAKES[number])])
    assert not story.violations and story.hit, story.summarize()


@pytest.mark.nightly
@pytest.mark.parametrize("first", range(0, 1000, 20))
def test_no_seed_of_a_journal_in_databases_violates_an_invariant(first: int) -> None:
    pytest.importorskip("psycopg")
    choice = SeedChoice(faults=tuple(dict.fromkeys(fault for _, fault in OF_DATABASES)))
    for seed in range(first, first + 20):
        story = run_scenario(seed, cells_of_seed(7 * seed, choice))  # stages and faults in turn
        assert not story.violations, story.summarize()


FOUND = [
    FaultCell("home", "one-way-gap", "cia402"),
    FaultCell("go", "arbitrary-replies", "cia402"),
    FaultCell("jog", "arbitrary-replies", "cia402"),
]


def test_faults_that_found_something_when_they_were_new_do_not_find_it_again() -> None:
    story = run_scenario(5, FOUND)
    assert not story.violations, story.summarize()
    assert len(story.hit) == len(FOUND)


CHAINED = [
    *(("stop", "shrc203"), ("estop", "smc4000"), ("permit-lost", "smc4000")),
    *(("host-killed", "smc2000"), ("power-off", "smc30"), ("coordinator-killed", "cia402")),
    *(("limit", "smc4000"), ("operator-interrupts", "ppsmc"), ("firmware-hung", "shrc203")),
]
"""Faults with one step moving and the next one loaded."""


@pytest.mark.parametrize("first", range(0, len(CHAINED), PHASES))
def test_no_fault_behind_a_moving_step_violates_an_invariant(first: int) -> None:
    cells = [FaultCell("chain", fault, make) for fault, make in CHAINED[first : first + PHASES]]
    story = run_scenario(first, cells)
    assert not story.violations, story.summarize()
    assert len(story.hit) >= len(cells) - 1


ON_PATHS = [("stop", "cia402")]
"""A fault while the next chunk of a path is loaded or released; nightly: all of them."""


def test_no_fault_between_two_chunks_of_a_path_violates_an_invariant() -> None:
    story = run_scenario(1, [FaultCell("chunk", fault, make) for fault, make in ON_PATHS])
    assert not story.violations, story.summarize()
    assert len(story.hit) == len(ON_PATHS)


@pytest.mark.nightly
@pytest.mark.parametrize("first", range(0, len(FAULTS), PHASES))
def test_no_fault_between_two_chunks_violates_an_invariant(first: int) -> None:
    for seed in range(first, first + 5):
        named = list(FAULTS.values())[first : first + PHASES]
        cells = [FaultCell("chunk", each.name, "smc4000") for each in named if "smc4000" in (each.makes or MAKES)]
        story = run_scenario(seed, cells)
        assert not story.violations, story.summarize()


TRIGGERED = [
    ("stop", "limit", "coordinator-killed"),
    ("estop", "link-closed", "host-killed"),
    ("power-cycle", "cable-pulled", "none"),
    ("router-hung", "router-hung", "router-hung"),
]
"""Faults while outputs are switched on the way."""


@pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in (2, 3, 4))])
def test_no_fault_makes_an_output_act_beside_its_step(seed: int) -> None:
    cells = [FaultCell("trigger", fault, TRIGGER_MAKE) for fault in TRIGGERED[seed - 1]]
    story = run_scenario(seed, cells)
    assert not story.violations, story.summarize()
    assert len(story.hit) >= PHASES - 1


AT_ONCE = [
    ("stop", "smc30"),
    ("host-killed", "ppsmc"),
    ("coordinator-killed", "shrc203"),
    ("bus-loss", "smc4000"),
    ("estop", "shrc203"),
    ("link-cut", "smc30"),
]
"""Faults while a step that starts at once waits behind a moving one; the first three in one seed, nightly all of them."""


LIVE = [("limit", "smc4000"), ("estop", "shrc203"), ("operator-lost", "smc30")]
"""Faults while a step that a live job was asked for moves, or is loaded behind a moving one."""


def test_no_fault_lets_a_live_job_go_on_behind_a_failure() -> None:
    story = run_scenario(1, [FaultCell("live", fault, make) for fault, make in LIVE])
    assert not story.violations, story.summarize()
    assert len(story.hit) == len(LIVE)


def test_no_fault_starts_a_step_twice_or_without_a_decision() -> None:
    story = run_scenario(1, [FaultCell("at-once", fault, make) for fault, make in AT_ONCE[:PHASES]])
    assert not story.violations, story.summarize()
    assert len(story.hit) == PHASES


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(2, 12))
def test_no_fault_starts_a_step_twice_in_other_seeds(seed: int) -> None:
    for first in (0, PHASES):
        cells = [FaultCell("at-once", fault, make) for fault, make in AT_ONCE[first : first + PHASES]]
        story = run_scenario(seed, cells)
        assert not story.violations, story.summarize()


FLYING = [
    (9, "estop", "smc4000"),  # in a turn-around, with pulses
    (1, "link-closed", "smc4000"),  # with pulses, behind a pause inside a line
    (47, "journal-full", "cia402"),  # a change of speed made a drive jump to the end of a chunk
    (45, "coordinator-killed", "cia402"),
    (6, "stop", "smc4000"),
    (15, "garbage", "cia402"),  # what was left of a line could not begin, and a good row was replaced
    (20, "link-closed", "smc4000"),
    (90, "link-closed", "cia402"),
    (7, "host-killed", "smc4000"),
    (13, "one-way-gap", "cia402"),
]
"""Faults in flights that are paused or go faster or slower; the first three in the suite, nightly all of them."""


@pytest.mark.parametrize(
    ("seed", "fault", "make"),
    [*FLYING[:PHASES], *(pytest.param(*cell, marks=pytest.mark.nightly) for cell in FLYING[PHASES:])],
)
def test_no_fault_in_a_flight_makes_a_row_good_that_is_not(seed: int, fault: str, make: str) -> None:
    story = run_scenario(seed, [FaultCell("flying", fault, make)])
    assert not story.violations and story.hit, story.summarize()


VIRTUAL = [("none", "shrc203"), ("stop", "smc4000"), ("limit", "cia402")]
"""Faults while virtual axes of a whole fleet move: in one seed, nightly all of them."""


def test_virtual_axes_stay_on_their_line_until_a_fault() -> None:
    story = run_scenario(1, [FaultCell("virtual", fault, make) for fault, make in VIRTUAL])
    assert not story.violations, story.summarize()
    assert len(story.hit) == len(VIRTUAL)


@pytest.mark.nightly
@pytest.mark.parametrize("seed", range(2, 202))
def test_virtual_axes_stay_on_their_line_in_other_seeds(seed: int) -> None:
    cells = cells_of_seed(seed, SeedChoice(("virtual",)))
    story = run_scenario(seed, cells)
    assert not story.violations, story.summarize()


PAIRED = [("host-killed", "smc4000"), ("link-cut", "cia402")]
"""Faults while two axes of two controllers carry one beam: in one seed, nightly all of them."""


def test_no_fault_racks_a_beam_farther_than_was_stated() -> None:
    story = run_scenario(1, [FaultCell("pair", fault, make) for fault, make in PAIRED])
    assert not story.violations, story.summarize()
    assert len(story.hit) == len(PAIRED)


PROBED = [
    (105, "coordinator-hung", "smc4000"),  # a request that the next leader had accepted was refused by the last one
    (12, "estop", "smc30"),  # the axis began to move after the e-stop that came while its program was loaded
    (4, "none", "cia402"),  # the drive was at rest before its state said so, and the next step was refused
    (81, "bus-loss", "smc2000"),  # polled at the rate of rest, it seemed to be silent
]
"""Faults while an axis moves towards a contact; the first two in the suite, nightly all of them."""


@pytest.mark.parametrize(
    ("seed", "fault", "make"),
    [*PROBED[:2], *(pytest.param(*cell, marks=pytest.mark.nightly) for cell in PROBED[2:])],
)
def test_no_fault_lets_an_axis_go_on_behind_its_contact(seed: int, fault: str, make: str) -> None:
    story = run_scenario(seed, [FaultCell("probe", fault, make)])
    assert not story.violations and story.hit, story.summarize()


ZONED = [
    (167, "nothing-forwarded", "cia402"),
    (61, "limit", "smc2000"),
    (4, "none", "cia402"),
    (23, "link-cut", "smc30"),
    (16, "host-other-file", "smc2000"),  # a drive that stood on its home edge was homed through a zone
    (148, "fleet-restarted", "smc30"),
]
"""Faults while carriages go to and fro in front of each other; the first two in the suite, nightly all of them."""


@pytest.mark.parametrize(
    ("seed", "fault", "make"),
    [*ZONED[:2], *(pytest.param(*cell, marks=pytest.mark.nightly) for cell in ZONED[2:])],
)
def test_no_fault_brings_bodies_of_zones_nearer_than_they_may_be(seed: int, fault: str, make: str) -> None:
    story = run_scenario(seed, [FaultCell("zone", fault, make)])
    assert not story.violations and story.hit, story.summarize()
    assert any(" is done" in event for event in story.events), story.summarize()


@pytest.mark.nightly
@pytest.mark.parametrize("stage", ["pair", "probe", "zone"])
@pytest.mark.parametrize("first", range(0, 200, 20))
def test_pairs_probes_and_zones_keep_their_bounds_in_other_seeds(stage: Stage, first: int) -> None:
    for seed in range(first, first + 20):
        story = run_scenario(seed, cells_of_seed(seed, SeedChoice((stage,))))
        assert not story.violations, story.summarize()


@pytest.mark.parametrize(
    ("seed", "fault", "make"),
    [
        (1036, "link-slow", "smc4000"),  # a decision that a late release left in the journal
        (2005, "none", "cia402"),  # planned from where an axis was in the middle of the step before the last
        (2145, "wall-clock", "smc2000"),  # loading took a daisy chain from its watchdogs
        (2217, "disk-full", "smc30"),  # an adapter that was silent for too long before the next start
    ],
)
def test_what_chains_found_when_they_were_new_is_not_found_again(seed: int, fault: str, make: str) -> None:
    story = run_scenario(seed, [FaultCell("chain", fault, make)])
    assert not story.violations and story.hit, story.summarize()


@pytest.mark.parametrize(
    ("seed", "stages"), [(11, STAGES[4::2]), *(pytest.param(at, STAGES, marks=pytest.mark.nightly) for at in (12, 13))]
)
def test_a_router_that_hangs_violates_no_invariant_at_any_stage(seed: int, stages: tuple[Stage, ...]) -> None:
    cells = [FaultCell(stage, "router-hung", MAKES[(at + seed) % len(MAKES)]) for at, stage in enumerate(stages)]
    story = run_scenario(seed, cells)
    assert not story.violations, story.summarize()
    assert len(story.hit) == len(cells)


def test_directed_seeds_reach_each_stage_fault_and_make() -> None:
    assert {cell.stage for cell in DIRECTED} == set(STAGES)
    directed_faults = {cell.fault for cell in DIRECTED} | {fault for _, fault in IN_HALLS + OF_DATABASES}
    assert directed_faults == set(FAULTS)
    assert {stage for stage, _ in IN_HALLS} == set(HALL_STAGES)
    assert {cell.make for cell in DIRECTED} == set(MAKES)


@pytest.mark.nightly
@pytest.mark.parametrize("first", range(0, SEEDS, CHUNK))
def test_no_seed_violates_an_invariant(first: int) -> None:
    hits = 0
    for seed in range(first, first + CHUNK):
        story = run_scenario(seed, cells_here(seed))
        assert not story.violations, story.summarize()
        assert len(story.fleet.controllers) >= 4 and story.jobs > PHASES
        hits += len(story.hit)
    assert hits >= CHUNK * (PHASES - 1)


@pytest.mark.nightly
@pytest.mark.parametrize(
    "seed",
    [885, 993, 2712, 3173, 8093, 51175, 52181, 53295, 54477, 6200402, 7310005, 7310146, 7310147],
)
def test_seeds_that_found_something_do_not_find_it_again(seed: int) -> None:
    story = run_scenario(seed, cells_of_seed(seed))
    assert not story.violations, story.summarize()


def test_the_campaign_covers_every_fault_at_every_stage() -> None:
    cells = [cell for seed in range(SEEDS) for cell in cells_here(seed)]
    assert {(cell.stage, cell.fault) for cell in cells} == {
        (stage, fault) for stage in STAGES for fault in ROUND_FAULTS
    }
    assert {cell.make for cell in cells} == set(MAKES)


def test_seeds_of_named_stages_step_through_every_fault_and_make_of_these() -> None:
    choice = SeedChoice(("chunk", "trigger"))
    cells = choice.list_cells()
    assert {cell.stage for cell in cells} == set(choice.stages) and {cell.fault for cell in cells} == set(ROUND_FAULTS)
    assert {cell.make for cell in cells if cell.stage == "trigger"} == {TRIGGER_MAKE}
    assert [cell for seed in range(len(cells)) for cell in cells_of_seed(seed, choice)] == cells
    assert get_args(Stage) == STAGE_NAMES
    alone = SeedChoice(faults=("coordinator-cut",))
    assert {cells_of_seed(seed, alone)[0].stage for seed in range(len(alone.list_cells()))} == set(STAGES)


def test_findings_of_a_campaign_are_counted() -> None:
    choice = SeedChoice(("propose",), ("stop",))
    found = run_campaign([2], choice=choice)
    assert (found.seeds, len(found.controllers), len(found.jobs)) == (1, 1, 1) and not found.violations
    assert sum(found.cells.values()) > sum(found.faults) == 1  # it is a fault of all
    assert len(found.missed_cells) + len(found.cells) == len(choice.list_cells()) and found.lowest_hits == 0


def test_a_round_has_every_cell_of_a_member_and_pairs_change_with_rounds() -> None:
    times = Counter(ROUND)
    assert set(ROUND) <= set(CELLS)
    of_all = {cell for cell in CELLS if FAULTS[cell.fault].reach == "fleet" and cell.stage not in SINGLE_MEMBER_STAGES}
    assert {cell: times[cell] for cell in set(CELLS) - of_all} == dict.fromkeys(set(CELLS) - of_all, 3)
    # Each counts for all makes that take part in its step.
    assert {times[cell] for cell in of_all} == {2}
    assert len({(cell.stage, cell.fault) for cell in ROUND[:PAIRS]}) == PAIRS
    assert (
        cells_of_seed(3)[0] == cells_of_seed(3 + len(ROUND))[0]
        and cells_of_seed(3)[1] != cells_of_seed(3 + len(ROUND))[1]
    )


def test_a_seed_is_reproducible() -> None:
    cells = (FaultCell("arm", "host-killed", "shrc203"),)
    first, again = run_scenario(17, cells), run_scenario(17, cells)
    assert first.lines == again.lines
    assert (first.hit, first.events, first.fleet) == (again.hit, again.events, again.fleet)


def test_the_same_fault_may_occur_twice_in_a_seed() -> None:
    estop = next(cell for cell in CELLS if cell.fault == "estop" and cell.stage == "arm")
    story = run_scenario(3, [estop, estop])
    assert not story.violations, story.summarize()
