"""The sequence of campaign seeds, and the counts of injected faults by stage, fault and make."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import partial
from itertools import product

from orchestrator.campaign.faults import FAULTS
from orchestrator.campaign.fleets import MAKES, STAGE_MAKES
from orchestrator.campaign.recording.recorder import STAGES, Stage
from orchestrator.campaign.scenario import SINGLE_MEMBER_STAGES, FaultCell, SeedRun, run_scenario
from orchestrator.campaign.stages.hall import HALL_LACKS, HALL_MAKE, HALL_STAGES
from orchestrator.runtime.workers import map_in_processes


@dataclass(frozen=True, slots=True)
class SeedChoice:
    """Which faults the seeds of a campaign have. stages, faults: with any, each seed has one fault, of these at these
    (none named: all). apart: each adapter host runs on a computer of its own. hall: each seed has one fault, in a
    hall."""

    stages: tuple[Stage, ...] = ()
    faults: tuple[str, ...] = ()
    apart: bool = False
    hall: bool = False

    @property
    def is_narrowed(self) -> bool:
        """Whether its seeds have one fault each."""
        return bool(self.stages or self.faults or self.hall)

    def list_cells(self) -> list[FaultCell]:
        """List every possible fault of each make at each stage; none if its fleets have none of them there."""
        if self.hall:
            return _list_hall_cells(self.stages or HALL_STAGES, self.faults or tuple(FAULTS))
        return [
            FaultCell(stage, name, make)
            for name, fault in FAULTS.items()
            if (name in self.faults if self.faults else not fault.own_seeds)
            for make in fault.makes or MAKES
            for stage in self.stages or STAGES
            if make in STAGE_MAKES.get(stage, MAKES)
        ]


def _list_hall_cells(stages: Sequence[Stage], faults: Sequence[str]) -> list[FaultCell]:
    return [
        FaultCell(stage, name, HALL_MAKE)
        for name, fault in FAULTS.items()
        if name in faults and name not in HALL_LACKS and fault.makes in ((), (HALL_MAKE,))
        for stage in HALL_STAGES
        if stage in stages
    ]


EVERY_SEED = SeedChoice()
CELLS = EVERY_SEED.list_cells()
ROUND_FAULTS = {name: fault for name, fault in FAULTS.items() if not fault.own_seeds}


def _make_round() -> list[FaultCell]:
    """List every cell three times, but cells of a fault that affects the whole fleet twice, because it counts for
    all makes that take part in its step. (Only one member is jogged or homed.)

    The first len(STAGES) * len(ROUND_FAULTS) are all pairs of stage and fault.
    """
    cells: list[FaultCell] = []
    for lap, turn in product(range(1, 4), range(len(MAKES))):
        for number, (name, fault) in enumerate(ROUND_FAULTS.items()):
            for offset, stage in enumerate(STAGES):
                makes = fault.makes or MAKES
                if turn >= len(makes):
                    continue  # each of them had its turn
                make = makes[(turn + number + offset) % len(makes)]
                if fault.reach != "fleet" or stage in SINGLE_MEMBER_STAGES or (lap + turn) % 3:
                    cells.append(FaultCell(stage, name, make))
    return cells


ROUND = _make_round()
PAIRS = len(STAGES) * len(ROUND_FAULTS)

# Preparing a fleet takes as long as a phase. With two phases ten thousand seeds target each cell 21 times, and some
# faults come too late for their target.
PHASES = 3


def cells_of_seed(seed: int, choice: SeedChoice = EVERY_SEED) -> list[FaultCell]:
    """Return the faults of a seed. Consecutive seeds step through all cells, and in the long run through all pairs
    of them."""
    if choice.is_narrowed:
        cells = choice.list_cells()
        return [cells[seed % len(cells)]]
    round_number = seed // len(ROUND)
    return [ROUND[(seed + act * (PAIRS // PHASES + 157 * round_number)) % len(ROUND)] for act in range(PHASES)]


@dataclass(slots=True)
class CampaignResult:
    """The results of a campaign.

    possible: the cells that its seeds step through.
    cells: number of faults by stage, kind and affected make.
    controllers, jobs, faults, fleet_s: one entry per seed."""

    possible: list[FaultCell]
    seeds: int = 0
    violations: dict[int, list[str]] = field(default_factory=dict[int, list[str]])
    cells: Counter[FaultCell] = field(default_factory=Counter[FaultCell])
    controllers: list[int] = field(default_factory=list[int])
    jobs: list[int] = field(default_factory=list[int])
    faults: list[int] = field(default_factory=list[int])
    fleet_s: list[float] = field(default_factory=list[float])
    controller_s: float = 0.0

    @property
    def missed_cells(self) -> list[FaultCell]:
        """Cells that were not hit. Each of them is possible: no stage, fault and make exclude each other."""
        return [cell for cell in self.possible if not self.cells[cell]]

    @property
    def lowest_hits(self) -> int:
        """The lowest number of hits of any cell."""
        return min(self.cells[cell] for cell in self.possible)


def run_seed(seed: int, choice: SeedChoice = EVERY_SEED) -> SeedRun:
    """Run a seed as the campaign does."""
    return run_scenario(seed, cells_of_seed(seed, choice), apart=choice.apart)


def run_campaign(
    seeds: Iterable[int],
    on_run: Callable[[SeedRun], None] = lambda _: None,
    processes: int = 1,
    choice: SeedChoice = EVERY_SEED,
) -> CampaignResult:
    """Run seeds in parallel `processes`; `on_run` receives each run, in the order of the seeds."""
    campaign = CampaignResult(choice.list_cells())
    for story in map_in_processes(partial(run_seed, choice=choice), seeds, processes):
        campaign.seeds += 1
        campaign.cells.update(story.affected)
        campaign.controllers.append(len(story.fleet.controllers))
        campaign.jobs.append(story.jobs)
        campaign.faults.append(len(story.hit))
        campaign.fleet_s.append(story.fleet_s)
        campaign.controller_s += story.fleet_s * len(story.fleet.controllers)
        if story.violations:
            campaign.violations[story.seed] = story.violations
        on_run(story)
    return campaign
