"""What delays of members may put the axes of a path beside it, and what their evidence proves afterwards."""

from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from orchestrator.coordinator.motion.negotiation import StartAgreement
from orchestrator.coordinator.motion.path_proof import prove_path
from orchestrator.coordinator.motion.path_terms import make_time_terms
from orchestrator.model.profile import Profile
from orchestrator.model.report import MemberBudget, MemberReport, PathBound, PathReport, PathTerm, SyncBudget
from orchestrator.model.state import AxisEvidence, TimeInterval
from orchestrator.model.units import Unit
from orchestrator.plan.path_step import PlannedPath
from orchestrator.plan.step import StepPlan

SPEED, MS = 100.0, 1_000_000
TIMES = np.linspace(0.0, 10.0, 1001)


def circle() -> PlannedPath:
    """Two members that share the speed of a circle."""
    speeds = {"a": SPEED * np.abs(np.sin(TIMES)), "b": SPEED * np.abs(np.cos(TIMES))}
    return cast(PlannedPath, SimpleNamespace(find_speeds=lambda member: (TIMES, speeds[member])))


def proposals(ppm: float = 10.0) -> Any:
    return {name: SimpleNamespace(clock_ppm=ppm) for name in ("a", "b")}


def test_delays_of_members_at_right_angles_add_up_as_squares() -> None:
    terms = make_time_terms(circle(), proposals(), {"a": 1e-3, "b": 1e-3}, {})
    starts = [term.size for term in terms if term.name == "start"]
    # 1 ms at 100 mm/s, whichever axis has that speed; it would be 0.2 if each were at its fastest.
    assert sum(starts) == pytest.approx(0.1, rel=2e-3) and starts == pytest.approx([0.05, 0.05], rel=1e-2)
    clocks = [term.size for term in terms if term.name == "clock"]
    assert sum(clocks) == pytest.approx(SPEED * 10e-6 * 10.0, rel=1e-2)


def test_a_clock_counts_from_its_last_fit_only() -> None:
    terms = make_time_terms(circle(), proposals(), {"a": 1e-3, "b": 1e-3}, {"a": 2.0, "b": 2.0})
    assert sum(term.size for term in terms if term.name == "clock") == pytest.approx(SPEED * 10e-6 * 2.0, rel=1e-2)


def test_members_that_stand_still_have_no_share() -> None:
    still = cast(PlannedPath, SimpleNamespace(find_speeds=lambda _: (TIMES, np.zeros(len(TIMES)))))
    assert {term.size for term in make_time_terms(still, proposals(), {"a": 1.0, "b": 1.0}, {})} == {0.0}


# Afterwards

DURATION_S = 2.0


def agree(members: tuple[str, ...] = ("a", "b")) -> StartAgreement:
    """Members whose axes go at 100 mm/s at most, for two seconds, with a bound of 0.5."""
    profile = Profile(0, 100_000, 1000.0, [1.0, 1.0], [100.0, -100.0], [0.0, 0.0])
    terms = [
        PathTerm(name="profile-fit", size=0.01),
        *(PathTerm(name="start", member=each, size=0.2) for each in members),
    ]
    bound = PathBound(unit=Unit.MM, tolerance=1.0, predicted=0.41, terms=terms)
    path = PathReport(unit=Unit.MM, length=100.0, duration_s=DURATION_S, bound=bound)
    plan = StepPlan(DURATION_S, {f"{each}.x": profile for each in members})
    return StartAgreement(plan, proposals=proposals(0.0), path=path)


def state_evidence(start_ms: tuple[float, float], end_ms: tuple[float, float] | None) -> MemberReport:
    def span(ends_ms: tuple[float, float], at_s: float = 0.0) -> TimeInterval:
        early, late = (round(at_s * 1e9 + each * MS) for each in ends_ms)
        return TimeInterval(earliest_ns=early, latest_ns=late)

    end = None if end_ms is None else span(end_ms, DURATION_S)
    evidence = {"x": AxisEvidence(start=span(start_ms), end=end)}
    return MemberReport(start_class="clock", axes=["x"], lowered_s={"x": DURATION_S}, evidence=evidence)


def prove(**reports: MemberReport) -> float | None:
    path = prove_path(agree(), reports, 0)
    assert path is not None and path.bound is not None
    return path.bound.proven


def test_what_starts_prove_is_around_the_middle_of_all() -> None:
    both = state_evidence((0.0, 1.0), None)
    # Half a millisecond each, at 100 mm/s each.
    assert prove(a=both, b=both) == pytest.approx(0.01 + 0.05 * 2**0.5, rel=1e-3)


def test_a_promise_narrows_what_evidence_leaves_open() -> None:
    window = MemberBudget(terms=[], earliest_ns=0, latest_ns=MS // 2)
    agreement = agree()
    agreement.budget = SyncBudget(
        predicted_ns=MS, allowed_ns=MS, worst_member="a", worst_term="", members={"a": window, "b": window}
    )
    both = state_evidence((-1.0, 1.0), None)
    path = prove_path(agreement, {"a": both, "b": both}, 0)
    assert path is not None and path.bound is not None
    assert path.bound.proven == pytest.approx(0.01 + 0.025 * 2**0.5, rel=1e-3)


def test_ends_prove_more() -> None:
    both = state_evidence((0.0, 1.0), (0.4, 0.6))
    assert prove(a=both, b=both) == pytest.approx(0.01 + 0.01 * 2**0.5, rel=1e-3)


def test_an_end_that_contradicts_its_start_proves_nothing() -> None:
    wrong = state_evidence((0.0, 1.0), (30.0, 31.0))
    assert prove(a=wrong, b=wrong) == pytest.approx(0.01 + 0.05 * 2**0.5, rel=1e-3)


def test_without_the_evidence_of_a_start_nothing_is_proven() -> None:
    assert prove(a=state_evidence((0.0, 1.0), None), b=MemberReport(start_class="clock", axes=["x"])) is None


def test_one_member_alone_is_off_by_its_own_terms_only() -> None:
    path = prove_path(agree(("a",)), {}, 0)
    assert path is not None and path.bound is not None and path.bound.proven == pytest.approx(0.01)
