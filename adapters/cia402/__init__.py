"""CANopen drives of CiA 402, one node of a CAN bus each (CiA 301 and CiA 402, by object names of the standards)."""

from adapters.cia402.make import Cia402

MAKE = Cia402()
