"""All checks of the contract."""

from orchestrator.conformance.losses import LOSS_CHECKS
from orchestrator.conformance.steps import STEP_CHECKS
from orchestrator.conformance.stops import STOP_CHECKS

CONTRACT_CHECKS = (*STEP_CHECKS, *STOP_CHECKS, *LOSS_CHECKS)
