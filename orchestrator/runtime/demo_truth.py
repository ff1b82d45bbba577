"""A job's verdicts against what the simulators wrote down that they did."""

import json
from pathlib import Path
from typing import NamedTuple

from orchestrator.model.fleet import Fleet
from orchestrator.model.report import JobReport


class Held(NamedTuple):
    """A motion step: its true start skew, ns, and whether the verdict holds it; outside: whose evidence does not hold
    their own start, and by how much."""

    step: int
    skew_ns: int
    held: bool
    outside: list[str]


def verdicts_against_truth(fleet: Fleet, report: JobReport, truth: Path, origin_host_ns: int) -> list[Held]:
    """For each motion step that was done. truth: the folder of the simulators' logs, host time of this kernel."""
    logged = {name: _starts(truth / f"{name}.jsonl") for name in fleet.controllers}
    found: list[Held] = []
    for step in report.steps:
        if step.start_skew is None or step.t0_fleet_ns is None or step.state != "done":
            continue
        true: list[int] = []
        outside: list[str] = []
        for name, member in step.members.items():
            for axis, evidence in member.evidence.items():
                motor = fleet.controllers[name].axes[axis].motors[0]
                t0_ns = step.t0_fleet_ns + origin_host_ns
                start_ns = min(
                    (at_ns for axis_name, at_ns in logged[name] if axis_name == motor),
                    key=lambda at_ns: abs(at_ns - t0_ns),
                    default=0,
                )
                true.append(start_ns)
                early_ns, late_ns = (
                    each + origin_host_ns
                    for each in (evidence.judged_start.earliest_ns, evidence.judged_start.latest_ns)
                )
                if not early_ns <= start_ns <= late_ns:
                    off_ns = start_ns - (early_ns if start_ns < early_ns else late_ns)
                    outside.append(f"{name}.{axis} by {off_ns / 1e6:+.2f} ms")
        skew_ns = max(true) - min(true) if true else 0
        within = step.start_skew.at_least_ns <= skew_ns <= step.start_skew.at_most_ns
        found.append(Held(step.index, skew_ns, within, outside))
    return found


def _starts(log: Path) -> list[tuple[str, int]]:
    """Axis and instant of every motion that began."""
    entries = (json.loads(line) for line in log.read_text(encoding="utf-8").splitlines())
    return [(entry["axis"], entry["start_ns"]) for entry in entries if entry["event"] == "start"]
