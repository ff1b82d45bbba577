"""The Python API for users: `from orchestrator.client import Job, Tutti`."""

from orchestrator.client.api import Tutti
from orchestrator.client.blocking import BlockingTutti
from orchestrator.client.jobs import SubmittedJob
from orchestrator.model.errors import Refusal
from orchestrator.model.job import Job

__all__ = ["BlockingTutti", "Job", "Refusal", "SubmittedJob", "Tutti"]
