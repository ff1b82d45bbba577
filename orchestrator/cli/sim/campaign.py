"""`tutti sim campaign`: fleets of all makes with faults at every stage of a step, in virtual time."""

import os
import statistics
from typing import TYPE_CHECKING, Any

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import console, json_option, print_json, processes_option
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.extras import require_extra

if TYPE_CHECKING:
    from orchestrator.campaign.recording.recorder import Stage
    from orchestrator.campaign.runs import CampaignResult, SeedChoice
    from orchestrator.campaign.scenario import SeedRun

STAGE_NAMES = (
    "jog",
    "home",
    "propose",
    "arm",
    "commit",
    "go",
    "fire",
    "motion",
    "chain",
    "chunk",
    "trigger",
    "at-once",
    "live",
    "armed-waiting",
    "flying",
    "virtual",
    "pair",
    "probe",
    "zone",
)
"""Those of the campaign, which is not loaded for the help text."""


@click.command(epilog="Example: tutti sim campaign --seeds 500 --json")
@click.option("--seeds", default=100, show_default=True, type=click.IntRange(1), help="Number of seeds.")
@click.option("--from", "first", default=0, show_default=True, type=click.IntRange(0), help="First seed.")
@click.option("--seed", type=click.IntRange(0), help="Run only this seed, and print its summary.")
@click.option("--trace", is_flag=True, help="With --seed: also print the complete log.")
@click.option(
    "--stage",
    "stages",
    multiple=True,
    type=click.Choice(STAGE_NAMES),
    help="Seeds with one fault, at this stage; several can be given. Only so there are faults at chunk, trigger, "
    "at-once, live, armed-waiting, flying, virtual, pair, probe and zone.",
)
@click.option("--fault", "faults", multiple=True, help="Seeds with one fault, of this kind; several can be given.")
@click.option("--hall", is_flag=True, help="Seeds with one fault, in fleets of 200 light controllers on four hosts.")
@click.option("--apart", is_flag=True, help="Each adapter host on a computer with a clock and network of its own.")
@processes_option
@json_option
def campaign(
    seeds: int,
    first: int,
    seed: int | None,
    stages: "tuple[Stage, ...]",
    faults: tuple[str, ...],
    processes: int,
    *,
    trace: bool,
    hall: bool,
    apart: bool,
    as_json: bool,
) -> None:
    """Run simulated fleets of random makes, inject faults at three stages of their steps, repair them, and check the
    true motions against the invariants of the design. A seed is fully deterministic. Exit 1 when an invariant is
    violated.
    """
    from orchestrator.campaign.runs import SeedChoice, run_campaign, run_seed

    choice = SeedChoice(stages, faults, apart, hall)
    _require_seeds(choice)
    if seed is not None:
        story = run_seed(seed, choice)
        if as_json:
            lines = {"log": story.lines} if trace else {}
            print_json({"seed": seed, "violations": [str(violation) for violation in story.violations], **lines})
        else:
            _print_plain("\n".join([*(story.lines if trace else []), story.summarize()]))
        raise SystemExit(FAILED if story.violations else 0)

    stage_options = [*(f" --stage {stage}" for stage in stages), *(f" --fault {fault}" for fault in faults)]
    options = "".join([*stage_options, " --hall" * hall, " --apart" * apart])

    def print_run(story: "SeedRun") -> None:
        if story.violations and not as_json:
            _print_plain(story.summarize())
            console.print(f"[bold]repeat:[/] tutti sim campaign --seed {story.seed}{options} --trace")

    began_s = _cpu_s()
    result = run_campaign(range(first, first + seeds), print_run, processes, choice)
    figures = _make_figures(result, _cpu_s() - began_s)
    if as_json:
        coverage = {f"{cell.stage} {cell.fault} {cell.make}": count for cell, count in sorted(result.cells.items())}
        print_json({**figures, "from": first, "violating": result.violations, "coverage": coverage})
    else:
        _print_coverage(result)
        console.print(", ".join(f"{name} {value}" for name, value in figures.items()), soft_wrap=True)
    if result.violations:
        raise SystemExit(FAILED)


def _require_seeds(choice: "SeedChoice") -> None:
    """Exit with an error where there is no seed of these faults at these stages."""
    from orchestrator.campaign.faults import FAULTS
    from orchestrator.model.fleet_names import suggest_name

    for fault in choice.faults:
        if fault not in FAULTS:
            remedy = f"{suggest_name(fault, FAULTS)}choose one of: {', '.join(FAULTS)}"
            exit_with_error(f"there is no fault {fault[:80]!r}", BAD_INPUT, remedy)
    if any(FAULTS[fault].of_databases for fault in choice.faults):
        require_extra("postgres", "psycopg")
    if not choice.list_cells():
        world = "a hall" if choice.hall else "fleets without `--hall`"
        names = ", ".join([*choice.faults, *choice.stages])
        exit_with_error(f"{world} cannot have {names} together", BAD_INPUT, "name other faults or stages")


def _cpu_s() -> float:
    """Return the core seconds used by this process and its finished child processes."""
    return sum(os.times()[:4])


def _make_figures(found: "CampaignResult", cpu_s: float) -> dict[str, Any]:
    """Return figures: seeds_per_s per core second; controller_s_per_cpu_s: fleet time times controllers."""
    return {
        "seeds": found.seeds,
        "violations": len(found.violations),
        "seeds_per_s": round(found.seeds / cpu_s, 2),
        "controller_s_per_cpu_s": round(found.controller_s / cpu_s, 1),
        "controllers_median": statistics.median(found.controllers),
        "jobs_median": statistics.median(found.jobs),
        "faults_median": statistics.median(found.faults),
        "fleet_s_median": round(statistics.median(found.fleet_s), 1),
        "cells": len(found.cells),
        "cells_missed": len(found.missed_cells),
        "least_in_a_cell": found.lowest_hits,
    }


def _print_coverage(found: "CampaignResult") -> None:
    """Print the number of hits by fault, affected make, and stage."""
    from orchestrator.campaign.runs import FaultCell
    from orchestrator.monitor.tables import make_plain_table

    stages: list[Stage] = list(dict.fromkeys(cell.stage for cell in found.possible))
    table = make_plain_table(["fault", "make", *(f"{stage}>" for stage in stages)])
    for fault in dict.fromkeys(cell.fault for cell in found.possible):
        for make in dict.fromkeys(cell.make for cell in found.possible):
            table.add_row(fault, make, *(str(found.cells[FaultCell(stage, fault, make)]) for stage in stages))
    console.print(table)


def _print_plain(text: str) -> None:
    console.print(text, highlight=False, markup=False, soft_wrap=True)
