"""Compare the decisions of campaign seeds with recorded ones: `campaign_decisions.py [--write] [FIRST LAST]`.

A refactoring must not change when a controller starts and stops, how a job ends and is judged, or which request is
refused with which code. `tests/cluster/decisions.jsonl` has a digest of these for seeds 0 to 99; names that have
changed since the first recording are mapped by `OLD_CODES`. A change that is meant is recorded with `--write`.
"""

import hashlib
import json
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path
from typing import Any
from unittest.mock import patch

from orchestrator.campaign.invariants import InvariantChecker
from orchestrator.campaign.recording.recorder import BusRecorder
from orchestrator.campaign.runs import run_seed
from orchestrator.runtime.virtual.fleet import VirtualFleet

RECORDED = Path(__file__).parents[1] / "tests" / "cluster" / "decisions.jsonl"
# Codes of refusals by their names in the recording.
OLD_CODES = {"feed-hold": "held", "leadership-lost": "deposed"}
PROCESSES = 2


def old_code(refusal: dict[str, Any] | None) -> str | None:
    """The code of a refusal, as it was called when the decisions were recorded."""
    return None if refusal is None else OLD_CODES.get(refusal["code"], refusal["code"])


def describe_motions(fleet: VirtualFleet) -> dict[str, Any]:
    """Axis, start and end of every true motion, by controller."""
    return {
        name: [[motion.axis, motion.start_ns, motion.end_ns] for motion in unit.commanded_motions]
        for name, unit in fleet.controllers.items()
    }


def describe_jobs(fleet: VirtualFleet) -> list[Any]:
    """Every job with its end, and each of its steps with verdict, refusal, T0, skews and predicted budget."""
    jobs: list[Any] = []
    found, _ = fleet.journal.find_jobs(limit=10_000)
    for row in reversed(found):  # oldest first
        report = fleet.journal.load_report(row.id)
        job: list[Any] = [row.id, row.state]
        for step in report.steps if report is not None else []:
            skews = [skew.model_dump() if skew else None for skew in (step.start_skew, step.end_skew)]
            refused = old_code(step.refused.model_dump() if step.refused else None)
            predicted_ns = step.budget.predicted_ns if step.budget else None
            job.append([step.index, step.do, step.state, step.verdict, refused, step.t0_fleet_ns, *skews, predicted_ns])
        jobs.append(job)
    return jobs


def describe_requests(recorder: BusRecorder) -> list[Any]:
    """Every request to a controller, when it was answered, and the refusal's code."""
    return [
        [each.verb, each.member, each.sent_ns, each.answered_ns, each.accepted, old_code(each.reply.get("refused"))]
        for each in recorder.requests
    ]


def digest_seed(seed: int) -> dict[str, Any]:
    """Run a seed; return a digest of each kind of decision."""
    parts: list[tuple[VirtualFleet, BusRecorder]] = []
    init = InvariantChecker.__init__

    def keep_parts(checker: InvariantChecker, fleet: VirtualFleet, recorder: BusRecorder, contacts: int) -> None:
        parts.append((fleet, recorder))
        init(checker, fleet, recorder, contacts)

    with patch.object(InvariantChecker, "__init__", keep_parts):
        run = run_seed(seed)
    ((fleet, recorder),) = parts
    found = {
        "cells": [list(cell) for cell in run.hit],
        "motions": describe_motions(fleet),
        "jobs": describe_jobs(fleet),
        "requests": describe_requests(recorder),
    }
    texts = {name: json.dumps(each, sort_keys=True) for name, each in found.items()}
    digests = {name: hashlib.sha256(text.encode()).hexdigest()[:16] for name, text in texts.items()}
    return {"seed": seed, "violations": len(run.violations), **digests}


def main() -> int:
    """Print what differs; exit code 1 if anything does."""
    words = [word for word in sys.argv[1:] if word != "--write"]
    first, last = (int(words[0]), int(words[1])) if words else (0, 99)
    with ProcessPoolExecutor(PROCESSES) as pool:
        found = list(pool.map(digest_seed, range(first, last + 1)))
    if "--write" in sys.argv:
        RECORDED.write_text("".join(json.dumps(each) + "\n" for each in found), encoding="utf-8")
        return 0
    recorded = {each["seed"]: each for each in map(json.loads, RECORDED.read_text(encoding="utf-8").splitlines())}
    different = 0
    for each in found:
        kinds = [kind for kind, value in recorded[each["seed"]].items() if each[kind] != value]
        different += bool(kinds)
        if kinds:
            print(f"seed {each['seed']}: different {', '.join(kinds)}")
    print(f"{different} of {len(found)} seeds decide otherwise than recorded")
    return 1 if different else 0


if __name__ == "__main__":
    raise SystemExit(main())
