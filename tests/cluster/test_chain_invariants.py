"""A fleet with a daisy chain, its members broken at each stage of a step: the invariants hold by the simulators' truth."""

import pytest
from cluster.test_chain import PREPARE, chain_fleet
from cluster.worlds import job

from orchestrator.lab.campaign import FAULTS, STAGES, run_seed

MOVE = job("[{do: move, to: {feeder.x: 300, turner.x: 250, outlet.x: 350, gantry.x: 300}, speed: 0.3}]")
CHUNK = 7
SEEDS = range(0, len(FAULTS), CHUNK)


@pytest.mark.parametrize("first", SEEDS)
def test_no_seed_violates_an_invariant(first: int) -> None:
    for seed in range(first, first + CHUNK):
        # Seeds walk through the faults, and by and by through all stages of each.
        stage, fault = STAGES[(seed // len(FAULTS) + seed) % len(STAGES)], FAULTS[seed % len(FAULTS)]
        story = run_seed(chain_fleet(), PREPARE, MOVE, seed, stage, fault)
        assert not story.violations, story.tell()
