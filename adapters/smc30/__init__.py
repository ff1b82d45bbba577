"""The adapter of the JVL SMC30 step motor controller, alone or up to seven on one serial bus."""

from adapters.contract import Make
from adapters.smc30.make import Smc30Make

MAKE: Make = Smc30Make()
