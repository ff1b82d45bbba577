"""Galil DMC-21x3 and DMC-40x0, on the code of the Yaskawa SMC-4000, which shares their dialect.

Never tried on hardware.
"""

from adapters.galil.driver import MAKE

__all__ = ["MAKE"]
