"""The whole suite for one make, as `tutti adapter check` runs it."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any, cast

from orchestrator.campaign.faults import FAULTS
from orchestrator.campaign.recording.recorder import STAGES
from orchestrator.campaign.runs import PHASES
from orchestrator.campaign.scenario import FaultCell, run_scenario
from orchestrator.conformance.examples import make_case
from orchestrator.conformance.findings import ContractBroken, NotApplicable, require
from orchestrator.conformance.losses import LOSS_CHECKS
from orchestrator.conformance.power_cuts import COMMANDED, CUT_MOMENTS_NS, check_power_cuts
from orchestrator.conformance.signatures import check_signatures
from orchestrator.conformance.steps import STEP_CHECKS
from orchestrator.conformance.stops import STOP_CHECKS
from orchestrator.conformance.wire_fuzz import run_conversation
from orchestrator.conformance.worlds import Case
from sim.core.vectors import check_file, find_simulator

CONTRACT_CHECKS = (*STEP_CHECKS, *STOP_CHECKS, *LOSS_CHECKS)
CONVERSATIONS = 40
# Of each kind of reach, and those that concern a driver most.
QUICK_FAULTS = (
    "host-killed",
    "link-cut",
    "garbage",
    "refusals",
    "power-cycle",
    "limit",
    "stop",
    "estop",
    "flapping-link",
)
LONG_CONVERSATIONS = 400


@dataclass(frozen=True, slots=True)
class MakeCheck:
    """One check of a make. part: contract, power cuts, replies, vectors or campaign. name: what holds if it passes."""

    part: str
    name: str
    call: Callable[[], None]

    def run(self) -> None:
        """Run it. Raises `ContractBroken`, `NotApplicable`, or what the plug-in raises."""
        self.call()


@dataclass(frozen=True, slots=True)
class CheckResult:
    """The result of a check. text: what was found, or why it does not apply."""

    part: str
    name: str
    state: str
    text: str = ""


def list_checks(make: str, *, everything: bool = False, case: Case | None = None) -> list[MakeCheck]:
    """Return all checks of an installed make. everything: also the variants that take minutes. case: the controller to
    be checked; None: that of the make's example.

    Raises `UnknownPlugin`, `PluginError`.
    """
    checks = _generate_checks(make, case or make_case(make), everything=everything)
    # The fleets of the campaign are made from the example.
    return [check for check in checks if case is None or check.part != "campaign"]


def run_check(check: MakeCheck) -> CheckResult:
    """Run one check; every error is a result."""
    try:
        check.run()
    except NotApplicable as reason:
        return CheckResult(check.part, check.name, "not-applicable", str(reason))
    except ContractBroken as breach:
        return CheckResult(check.part, check.name, "broken", str(breach))
    except Exception as error:
        return CheckResult(check.part, check.name, "broken", f"{type(error).__name__}: {error}")
    return CheckResult(check.part, check.name, "holds")


def _generate_checks(make: str, case: Case, *, everything: bool) -> Iterator[MakeCheck]:
    yield MakeCheck("contract", "methods have the parameters of the contract", partial(check_signatures, case))
    for check in CONTRACT_CHECKS:
        if everything or not check.is_long:
            yield MakeCheck("contract", check.name, partial(check.run, case))
    moments_ns = CUT_MOMENTS_NS if everything else CUT_MOMENTS_NS[::4]
    for act, command in COMMANDED.items():
        name = f"nothing begins after a short power cut during a {act}"
        yield MakeCheck("power cuts", name, partial(check_power_cuts, case, command, moments_ns))
    number = LONG_CONVERSATIONS if everything else CONVERSATIONS
    name = f"{number} conversations with wrong replies end in faults only"
    yield MakeCheck("replies", name, partial(_check_conversations, make, case, number))
    for seed, cells in enumerate(_draw_cells(make, everything=everything)):
        name = f"no invariant is violated with {', '.join(cell.fault for cell in cells)}"
        yield MakeCheck("campaign", name, partial(_check_seed, seed, cells))
    for file in vector_files(make):
        yield MakeCheck("vectors", f"the simulator fulfils {file.name}", partial(_check_vectors, make, file))


def vector_files(make: str) -> Sequence[Path]:
    """Return the files of vectors that a make's simulator names (attribute `vector_files`)."""
    return cast(Sequence[Path], getattr(cast(Any, find_simulator(make)), "vector_files", ()))


def _draw_cells(make: str, *, everything: bool) -> list[list[FaultCell]]:
    """Return the faults of each seed: each at a stage of its own, directed at a controller of this make."""
    faults = [name for name, fault in FAULTS.items() if make in fault.makes or not fault.makes]
    if not everything:
        faults = [name for name in faults if name in QUICK_FAULTS]
    cells = [FaultCell(STAGES[number % len(STAGES)], name, make) for number, name in enumerate(faults)]
    return [cells[first : first + PHASES] for first in range(0, len(cells), PHASES)]


def _check_seed(seed: int, cells: Sequence[FaultCell]) -> None:
    story = run_scenario(seed, cells)
    require(not story.violations, "; ".join(story.violations))


def _check_conversations(make: str, case: Case, number: int) -> None:
    for seed in range(number):
        try:
            run_conversation(make, case, seed)
        except ContractBroken:
            raise
        except Exception as error:
            raise ContractBroken(f"conversation {seed} ended with {type(error).__name__}: {error}") from error


def _check_vectors(make: str, file: Path) -> None:
    report = check_file(make, file)
    text = f"{len(report.failures)} of {len(report.failures) + len(report.passed)} vectors fail"
    for failures in list(report.failures.values())[:1]:
        failure = failures[0]
        text += f"; {failure.vector}: sent {failure.sent!r}, expected {failure.expected}, received {failure.received}"
    require(not report.failures, text)
    require(report.passed, f"{file} has no vectors")
