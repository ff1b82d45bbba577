"""Simulated Galil DMC-21x3 and DMC-40x0: the machine of the Yaskawa SMC-4000 with their identification and records."""

from sim.galil.simulator import GALIL

__all__ = ["GALIL"]
