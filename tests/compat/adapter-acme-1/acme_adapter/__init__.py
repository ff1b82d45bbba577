"""The adapter for acme."""

from acme_adapter.make import MAKE

__all__ = ["MAKE"]
