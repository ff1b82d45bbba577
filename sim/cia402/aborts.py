"""SDO abort codes (CiA 301, table 22)."""

from orchestrator.model.errors import TuttiError


class SdoAbort(TuttiError):
    """The drive refuses an access; the code is sent to the client."""

    def __init__(self, code: int) -> None:
        super().__init__(f"SDO abort {code:#010x}")
        self.code = code


TOGGLE = 0x0503_0000
TIMED_OUT = 0x0504_0000
COMMAND = 0x0504_0001
BLOCK_SIZE = 0x0504_0002
SEQUENCE = 0x0504_0003
CRC = 0x0504_0004
UNSUPPORTED = 0x0601_0000
WRITE_ONLY = 0x0601_0001
READ_ONLY = 0x0601_0002
NO_OBJECT = 0x0602_0000
NOT_MAPPABLE = 0x0604_0041
PDO_LENGTH = 0x0604_0042
PARAMETER = 0x0604_0043
HARDWARE = 0x0606_0000
LENGTH = 0x0607_0010
TOO_LONG = 0x0607_0012
TOO_SHORT = 0x0607_0013
NO_SUBINDEX = 0x0609_0011
RANGE = 0x0609_0030
TOO_HIGH = 0x0609_0031
TOO_LOW = 0x0609_0032
NOT_STORED = 0x0800_0020
DEVICE_STATE = 0x0800_0022
"""The value cannot be accepted in the present state of the drive."""
