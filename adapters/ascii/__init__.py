"""Controllers with simple text lines, described by a file."""

from adapters.ascii.make import MAKE

__all__ = ["MAKE"]
