"""The adapter of the pp-electronic SMC step-motor controller (also sold as Huber SMC 9000 and 9300)."""

from adapters.contract import Make
from adapters.ppsmc.make import PpSmcMake

MAKE: Make = PpSmcMake()
