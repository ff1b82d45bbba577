"""The adapter of the OptoSigma SHRC-203 three-axis stage controller, command format SHOT/FC."""

from adapters.contract import Make
from adapters.shrc203.make import Shrc203Make

MAKE: Make = Shrc203Make()
