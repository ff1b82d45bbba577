"""Simulated motion controllers of Yaskawa: one dialect, several models."""

from sim.yaskawa.smc4000 import SMC4000

__all__ = ["SMC4000"]
