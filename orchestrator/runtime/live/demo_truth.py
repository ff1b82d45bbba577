"""A check of a job's verdicts against the motions that the simulators recorded."""

import json
from pathlib import Path
from typing import NamedTuple

from orchestrator.model.fleet import Fleet
from orchestrator.model.report import JobReport


class VerdictCheck(NamedTuple):
    """The check of one motion step.

    skew_ns: its true start skew.
    held: the verdict is consistent with it.
    outside: members whose evidence does not contain their own start, and by how much."""

    step: int
    skew_ns: int
    held: bool
    outside: list[str]


def check_verdicts(fleet: Fleet, report: JobReport, truth: Path, origin_host_ns: int) -> list[VerdictCheck]:
    """Check each completed motion step. truth: the folder of the simulators' logs, in host time of this kernel."""
    logged_starts = {name: _load_starts(truth / f"{name}.jsonl") for name in fleet.controllers}
    verdicts: list[VerdictCheck] = []
    for step in report.steps:
        if step.start_skew is None or step.t0_fleet_ns is None or step.state != "done":
            continue
        true: list[int] = []
        deviations: list[str] = []
        for name, member in step.members.items():
            for axis, evidence in member.evidence.items():
                motor = fleet.controllers[name].axes[axis].motors[0]
                t0_ns = step.t0_fleet_ns + origin_host_ns
                start_ns = min(
                    (at_ns for axis_name, at_ns in logged_starts[name] if axis_name == motor),
                    key=lambda at_ns: abs(at_ns - t0_ns),
                    default=0,
                )
                true.append(start_ns)
                early_ns, late_ns = (
                    instant_ns + origin_host_ns
                    for instant_ns in (evidence.start_for_verdict.earliest_ns, evidence.start_for_verdict.latest_ns)
                )
                if not early_ns <= start_ns <= late_ns:
                    off_ns = start_ns - (early_ns if start_ns < early_ns else late_ns)
                    deviations.append(f"{name}.{axis} by {off_ns / 1e6:+.2f} ms")
        skew_ns = max(true) - min(true) if true else 0
        is_within = step.start_skew.at_least_ns <= skew_ns <= step.start_skew.at_most_ns
        verdicts.append(VerdictCheck(step.index, skew_ns, is_within, deviations))
    return verdicts


def _load_starts(log: Path) -> list[tuple[str, int]]:
    """Return axis and instant of the start of every motion."""
    entries = (json.loads(line) for line in log.read_text(encoding="utf-8").splitlines())
    return [(entry["axis"], entry["start_ns"]) for entry in entries if entry["event"] == "start"]
