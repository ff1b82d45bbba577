"""Requests to a fleet over the bus. Users import them from `tutti`."""

from orchestrator.client.api import Tutti
from orchestrator.client.blocking import BlockingTutti
from orchestrator.client.jobs import SubmittedJob

__all__ = ["BlockingTutti", "SubmittedJob", "Tutti"]
