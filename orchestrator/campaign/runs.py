"""Seeds of the fault campaign, one after the other, and how often each cell of stage, fault and make was hit."""

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
    """Every cell three times; those of a fault that befalls the whole fleet twice, because it counts for all makes that
    take part in its step. (One is jogged, or looks for its reference, alone.)

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

# To prepare a fleet takes as long as an act. With two of them ten thousand seeds aim at each cell 21 times, and some of
# what is aimed at comes too late.
ACTS = 3


def cells_of(seed: int) -> list[Cell]:
    """What breaks in a seed. Seeds walk through all cells, and by and by through all pairs of them."""
    again = seed // len(ROUND)
    return [ROUND[(seed + act * (PAIRS // ACTS + 157 * again)) % len(ROUND)] for act in range(ACTS)]


@dataclass(slots=True)
class Campaign:
    """What was found. cells: faults by stage, kind and make of those that they befell; controllers, jobs, faults,
    fleet_s: one entry a seed."""

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
        """Cells that were not hit. Each of them can be: no stage, fault and make exclude each other."""
        return [cell for cell in CELLS if not self.cells[cell]]

    @property
    def least(self) -> int:
        """How often the cell was hit that was hit least."""
        return min(self.cells[cell] for cell in CELLS)


def play_seed(seed: int) -> Story:
    """Play a seed as the campaign does."""
    return play(seed, cells_of(seed))


def run_campaign(seeds: Iterable[int], told: Callable[[Story], None] = lambda _: None, processes: int = 1) -> Campaign:
    """Play seeds, as many at a time as there are processes; `told` hears of each, in their order."""
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
