"""CANopen drives of CiA 402, each a node of a CAN bus (CiA 301 and CiA 402, with the object names of the standards)."""

from adapters.cia402.make import Cia402Make

MAKE = Cia402Make()
