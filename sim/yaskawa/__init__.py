"""Simulated motion controllers of Yaskawa: one dialect, several models."""

from sim.yaskawa.smc2000.simulator import SMC2000
from sim.yaskawa.smc4000 import SMC4000

__all__ = ["SMC2000", "SMC4000"]
