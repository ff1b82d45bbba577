"""The contract suite for tests of a make's own package."""

from orchestrator.conformance.findings import ContractBroken, NotApplicable
from orchestrator.conformance.suite import CheckResult, MakeCheck, list_checks, run_check

__all__ = ["CheckResult", "ContractBroken", "MakeCheck", "NotApplicable", "list_checks", "run_check"]
