"""The light controller, which exists in no hardware: for benchmarks and tests of large fleets. See `sim.light`."""

from adapters.light.make import MAKE

__all__ = ["MAKE"]
