"""The sequence of campaign seeds, and the counts of injected faults by stage, fault and make."""

from collections import Counter
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from itertools import product

from orchestrator.campaign.faults import FAULTS
from orchestrator.campaign.fleets import MAKES
from orchestrator.campaign.recorder import STAGES
from orchestrator.campaign.scenario import ALONE, Cell, Story, play
from orchestrator.runtime.workers import spread

CELLS = [Cell(stage, fault, make) for fault in FAULTS for make in MAKES for stage in STAGES]


def _round() -> list[Cell]:
    """List every cell three times, but cells of a fault that affects the whole fleet twice, because it counts for
    all makes that take part in its step. (Only one member is jogged or homed.)

    The first len(STAGES) * len(FAULTS) are all pairs of stage and fault.
    """
    cells: list[Cell] = []
    for lap, turn in product(range(1, 4), range(len(MAKES))):
        for number, (name, fault) in enumerate(FAULTS.items()):
            for place, stage in enumerate(STAGES):
                make = MAKES[(turn + number + place) % len(MAKES)]
                if fault.reach != "fleet" or stage in ALONE or (lap + turn) % 3:
                    cells.append(Cell(stage, name, make))
    return cells


ROUND = _round()
PAIRS = len(STAGES) * len(FAULTS)

# Preparing a fleet takes as long as a phase. With two phases ten thousand seeds target each cell 21 times, and some
# faults come too late for their target.
ACTS = 3


def cells_of(seed: int) -> list[Cell]:
    """Return the faults of a seed. Consecutive seeds step through all cells, and in the long run through all pairs
    of them."""
    again = seed // len(ROUND)
    return [ROUND[(seed + act * (PAIRS // ACTS + 157 * again)) % len(ROUND)] for act in range(ACTS)]


@dataclass(slots=True)
class Campaign:
    """The results of a campaign.

    cells: number of faults by stage, kind and affected make.
    controllers, jobs, faults, fleet_s: one entry per seed."""

    seeds: int = 0
    violations: dict[int, list[str]] = field(default_factory=dict[int, list[str]])
    cells: Counter[Cell] = field(default_factory=Counter[Cell])
    controllers: list[int] = field(default_factory=list[int])
    jobs: list[int] = field(default_factory=list[int])
    faults: list[int] = field(default_factory=list[int])
    fleet_s: list[float] = field(default_factory=list[float])
    controller_s: float = 0.0

    @property
    def missed(self) -> list[Cell]:
        """Cells that were not hit. Each of them is possible: no stage, fault and make exclude each other."""
        return [cell for cell in CELLS if not self.cells[cell]]

    @property
    def least(self) -> int:
        """The lowest number of hits of any cell."""
        return min(self.cells[cell] for cell in CELLS)


def play_seed(seed: int) -> Story:
    """Run a seed as the campaign does."""
    return play(seed, cells_of(seed))


def run_campaign(seeds: Iterable[int], told: Callable[[Story], None] = lambda _: None, processes: int = 1) -> Campaign:
    """Run seeds in parallel `processes`; `told` receives each run, in the order of the seeds."""
    found = Campaign()
    for story in spread(play_seed, seeds, processes):
        found.seeds += 1
        found.cells.update(story.befallen)
        found.controllers.append(len(story.fleet.controllers))
        found.jobs.append(story.jobs)
        found.faults.append(len(story.hit))
        found.fleet_s.append(story.fleet_s)
        found.controller_s += story.fleet_s * len(story.fleet.controllers)
        if story.violations:
            found.violations[story.seed] = story.violations
        told(story)
    return found
