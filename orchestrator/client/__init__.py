"""The Python API for users: `from orchestrator.client import Tutti`."""

from orchestrator.client.api import Refused, Tutti

__all__ = ["Refused", "Tutti"]
