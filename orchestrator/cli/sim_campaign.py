"""`tutti sim campaign`: fleets of all makes broken at every stage, in virtual time."""

import statistics
import time

import click

from orchestrator.cli.codes import FAILED
from orchestrator.cli.common import console, json_option, print_json


@click.command(epilog="Example: tutti sim campaign --seeds 500 --json")
@click.option("--seeds", default=100, show_default=True, type=click.IntRange(1), help="How many.")
@click.option("--from", "first", default=0, show_default=True, type=click.IntRange(0), help="The first one.")
@click.option("--seed", type=click.IntRange(0), help="Only this one.")
@click.option("--trace", is_flag=True, help="With --seed: everything that was logged.")
@json_option
def campaign(seeds: int, first: int, seed: int | None, trace: bool, as_json: bool) -> None:
    """Break simulated fleets of random makes, each at a stage of a synchronised step, and hold what really moved to the
    invariants of the design. A seed plays exactly the same every time. Exit 1 when one violates an invariant.
    """
    from orchestrator.lab.campaign import Story
    from orchestrator.lab.campaign_runs import play, run_campaign

    if seed is not None:
        story, fleet = play(seed)
        names = ", ".join(f"{name} ({config.adapter})" for name, config in fleet.controllers.items())
        console.print(f"fleet: {names}", highlight=False, markup=False, soft_wrap=True)
        console.print("\n".join(story.lines) if trace else story.tell(), highlight=False, markup=False, soft_wrap=True)
        raise SystemExit(FAILED if story.violations else 0)

    def told(story: Story) -> None:
        if story.violations and not as_json:
            console.print(story.tell(), highlight=False, markup=False, soft_wrap=True)
            console.print(f"[bold]again:[/] tutti sim campaign --seed {story.seed} --trace")

    began_s = time.process_time()
    found = run_campaign(range(first, first + seeds), told)
    cpu_s = time.process_time() - began_s
    makes = sorted({make for _, _, make in found.cells})
    cells = {f"{stage} {fault} {make}": count for (stage, fault, make), count in sorted(found.cells.items())}
    figures = {
        "seeds": found.seeds,
        "violations": len(found.violations),
        "seeds_per_s": round(found.seeds / cpu_s, 2),
        "fleet_s": round(found.fleet_s),
        "controller_s_per_cpu_s": round(found.controller_s / cpu_s, 1),
        "controllers_median": statistics.median(found.controllers),
    }
    if as_json:
        print_json({**figures, "violating": found.violations, "coverage": cells, "from": first})
    else:
        from orchestrator.lab.campaign import FAULTS, STAGES
        from orchestrator.monitor.tables import plain_table

        table = plain_table(["fault", *(f"{stage}>" for stage in STAGES)])
        for fault in FAULTS:
            table.add_row(fault, *(str(sum(found.cells[stage, fault, make] for make in makes)) for stage in STAGES))
        console.print(table)
        console.print(", ".join(f"{name} {value}" for name, value in figures.items()), soft_wrap=True)
    if found.violations:
        raise SystemExit(FAILED)
