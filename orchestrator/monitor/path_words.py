"""A planned path in a few lines."""

from orchestrator.model.jobs.forecast import StepForecast
from orchestrator.model.report import PairBound, PathReport, PositionBound, RackBound, StepReport

MAX_BINDING = 4  # limits that are named in one line


def describe_path(report: PathReport) -> list[str]:
    """A path in a few lines: length and duration, what limits it most of the time, and the bound term by term."""
    unit = report.unit
    length = f"{report.length:.6g} {unit}" + (f" in frame {report.frame}" if report.frame else "")
    lines = [f"path of {length} in {report.duration_s:.3f} s; limited by {_describe_binding(report)}"]
    bound = report.bound
    if bound is None:
        return lines
    lines.append(f"at most {bound.predicted:.3g} {unit} off the path; the tolerance is {bound.tolerance:.3g} {unit}:")
    by_member: dict[str, list[str]] = {}
    for term in bound.terms:
        by_member.setdefault(term.member or "plan", []).append(f"{term.name} {term.size:.2g}")
    lines += [f"  {member}: {', '.join(sizes)} {unit}" for member, sizes in by_member.items()]
    if bound.proven is not None:
        lines.append(f"proven afterwards: at most {bound.proven:.3g} {unit}")
    return lines


def _describe_binding(report: PathReport) -> str:
    """What limits the speed, the longest first, with its share of the time."""
    spans: dict[str, float] = {}
    for stretch in report.stretches:
        spans[stretch.binds] = spans.get(stretch.binds, 0.0) + stretch.to_s - stretch.from_s
    whole_s = sum(spans.values())
    longest = sorted(spans, key=lambda binds: -spans[binds])
    shown_limits = [f"{binds} ({100 * spans[binds] / whole_s:.0f} %)" for binds in longest[:MAX_BINDING] if whole_s]
    more = len(longest) - len(shown_limits)
    return ", ".join(shown_limits) + (f" and {more} more" if more else "") if shown_limits else "nothing"


def _describe_pair(group: str, bound: PairBound) -> str:
    """How far a pair may be racked: `beam: at most 0.83 mm apart after a single fault`."""
    return f"{group}: at most {bound.most:.3g} {bound.unit} apart after a single fault"


def _describe_bound(axis: str, bound: PositionBound) -> str:
    """The bound of an axis with its causes: `gantry.x ends within 0.0015 mm of its target (…)`."""
    causes = {"rounding": bound.rounding, "table": bound.table, "play": bound.play}
    terms = ", ".join(f"{name} {value:.3g}" for name, value in causes.items() if value)
    return f"{axis} ends within {bound.most:.3g} {bound.unit} of its target ({terms})"


def _describe_rack(axis: str, rack: RackBound) -> str:
    """How far the two motors of an axis may be apart."""
    return (
        f"the motors of {axis} are at most {rack.watched:.3g} {rack.unit} apart, and at most {rack.most:.3g} after a "
        f"single fault (at {rack.speed:.3g} {rack.unit}/s)"
    )


def describe_bounds(step: StepReport | StepForecast) -> list[str]:
    """How far the axes of a step may be from their targets, and motors or axes that carry one beam apart."""
    lines = [_describe_bound(name, bound) for name, bound in step.bounds.items()]
    lines += [_describe_rack(name, rack) for name, rack in step.racks.items()]
    return lines + [_describe_pair(name, pair) for name, pair in step.pairs.items()]
