"""Objects of CiA 301 and CiA 402 that the adapter reads, writes and maps, with their names in the standards."""

from collections.abc import Iterator
from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class DictionaryObject:
    """One variable of the object dictionary. bits: its length in a frame."""

    index: int
    sub: int
    bits: int
    name: str
    signed: bool = False

    @property
    def mapping_entry(self) -> int:
        """Return its entry in a mapping parameter object (CiA 301: index, sub-index, length)."""
        return self.index << 16 | self.sub << 8 | self.bits

    @property
    def byte_size(self) -> int:
        """Return its length in bytes."""
        return self.bits // 8

    def encode(self, value: int) -> bytes:
        return value.to_bytes(self.byte_size, "little", signed=self.signed)

    def decode(self, data: bytes) -> int:
        return int.from_bytes(data[: self.byte_size], "little", signed=self.signed)

    def __str__(self) -> str:
        return f"{self.name} ({self.index:04X}h:{self.sub:02X})"


DEVICE_TYPE = DictionaryObject(0x1000, 0, 32, "device type")
ERROR_REGISTER = DictionaryObject(0x1001, 0, 8, "error register")
SYNC_ID = DictionaryObject(0x1005, 0, 32, "COB-ID SYNC")
SYNC_PERIOD = DictionaryObject(0x1006, 0, 32, "communication cycle period")
CONSUMER = DictionaryObject(0x1016, 1, 32, "consumer heartbeat time")
HEARTBEAT = DictionaryObject(0x1017, 0, 16, "producer heartbeat time")
VENDOR = DictionaryObject(0x1018, 1, 32, "vendor-ID")
PRODUCT = DictionaryObject(0x1018, 2, 32, "product code")
SERIAL = DictionaryObject(0x1018, 4, 32, "serial number")
DEVICE_NAME = DictionaryObject(0x1008, 0, 0, "manufacturer device name")
SOFTWARE = DictionaryObject(0x100A, 0, 0, "manufacturer software version")

ABORT_CONNECTION_OPTION = DictionaryObject(0x6007, 0, 16, "abort connection option code", signed=True)
ERROR_CODE = DictionaryObject(0x603F, 0, 16, "error code")
CONTROLWORD = DictionaryObject(0x6040, 0, 16, "controlword")
STATUSWORD = DictionaryObject(0x6041, 0, 16, "statusword")
QUICK_STOP_OPTION = DictionaryObject(0x605A, 0, 16, "quick stop option code", signed=True)
SHUTDOWN_OPTION = DictionaryObject(0x605B, 0, 16, "shutdown option code", signed=True)
DISABLE_OPTION = DictionaryObject(0x605C, 0, 16, "disable operation option code", signed=True)
FAULT_OPTION = DictionaryObject(0x605E, 0, 16, "fault reaction option code", signed=True)
HALT_OPTION = DictionaryObject(0x605D, 0, 16, "halt option code", signed=True)
MODE = DictionaryObject(0x6060, 0, 8, "modes of operation", signed=True)
MODE_DISPLAY = DictionaryObject(0x6061, 0, 8, "modes of operation display", signed=True)
DEMAND = DictionaryObject(0x6062, 0, 32, "position demand value", signed=True)
ACTUAL = DictionaryObject(0x6064, 0, 32, "position actual value", signed=True)
FOLLOWING_WINDOW = DictionaryObject(0x6065, 0, 32, "following error window")
FOLLOWING_TIMEOUT = DictionaryObject(0x6066, 0, 16, "following error time out")
POSITION_WINDOW = DictionaryObject(0x6067, 0, 32, "position window")
POSITION_WINDOW_TIME = DictionaryObject(0x6068, 0, 16, "position window time")
VELOCITY = DictionaryObject(0x606C, 0, 32, "velocity actual value", signed=True)
TARGET = DictionaryObject(0x607A, 0, 32, "target position", signed=True)
HOME_OFFSET = DictionaryObject(0x607C, 0, 32, "home offset", signed=True)
LIMIT_LOW = DictionaryObject(0x607D, 1, 32, "min position limit", signed=True)
LIMIT_HIGH = DictionaryObject(0x607D, 2, 32, "max position limit", signed=True)
POLARITY = DictionaryObject(0x607E, 0, 8, "polarity")
VELOCITY_MAX = DictionaryObject(0x607F, 0, 32, "max profile velocity")
MOTOR_SPEED_MAX = DictionaryObject(0x6080, 0, 32, "max motor speed")
PROFILE_VELOCITY = DictionaryObject(0x6081, 0, 32, "profile velocity")
ACCELERATION = DictionaryObject(0x6083, 0, 32, "profile acceleration")
DECELERATION = DictionaryObject(0x6084, 0, 32, "profile deceleration")
QUICK_STOP_DECELERATION = DictionaryObject(0x6085, 0, 32, "quick stop deceleration")
PROFILE_TYPE = DictionaryObject(0x6086, 0, 16, "motion profile type", signed=True)
ENCODER = (
    DictionaryObject(0x608F, 1, 32, "encoder increments"),
    DictionaryObject(0x608F, 2, 32, "motor revolutions of 608Fh"),
)
GEAR = (
    DictionaryObject(0x6091, 1, 32, "gear motor revolutions"),
    DictionaryObject(0x6091, 2, 32, "gear shaft revolutions"),
)
FEED = (DictionaryObject(0x6092, 1, 32, "feed"), DictionaryObject(0x6092, 2, 32, "shaft revolutions of 6092h"))
VELOCITY_FACTOR = (
    DictionaryObject(0x6096, 1, 32, "velocity factor numerator"),
    DictionaryObject(0x6096, 2, 32, "velocity factor divisor"),
)
ACCELERATION_FACTOR = (
    DictionaryObject(0x6097, 1, 32, "acceleration factor numerator"),
    DictionaryObject(0x6097, 2, 32, "acceleration factor divisor"),
)
HOMING_METHOD = DictionaryObject(0x6098, 0, 8, "homing method", signed=True)
HOMING_SWITCH_SPEED = DictionaryObject(0x6099, 1, 32, "speed during search for switch")
HOMING_ZERO_SPEED = DictionaryObject(0x6099, 2, 32, "speed during search for zero")
HOMING_ACCELERATION = DictionaryObject(0x609A, 0, 32, "homing acceleration")
PROBE_FUNCTION = DictionaryObject(0x60B8, 0, 16, "touch probe function")
PROBE_STATUS = DictionaryObject(0x60B9, 0, 16, "touch probe status")
PROBE_POSITIONS = (
    (
        DictionaryObject(0x60BA, 0, 32, "touch probe 1 positive edge", signed=True),
        DictionaryObject(0x60BB, 0, 32, "touch probe 1 negative edge", signed=True),
    ),
    (
        DictionaryObject(0x60BC, 0, 32, "touch probe 2 positive edge", signed=True),
        DictionaryObject(0x60BD, 0, 32, "touch probe 2 negative edge", signed=True),
    ),
)
"""By probe, of its rising and of its falling edge."""
INPUTS = DictionaryObject(0x60FD, 0, 32, "digital inputs")
OUTPUTS = DictionaryObject(0x60FE, 1, 32, "physical outputs")
OUTPUT_MASK = DictionaryObject(0x60FE, 2, 32, "output bit mask")
INTERPOLATION_POSITION = DictionaryObject(0x60C1, 1, 32, "interpolation data record", signed=True)
PERIOD = DictionaryObject(0x60C2, 1, 8, "interpolation time period value")
PERIOD_INDEX = DictionaryObject(0x60C2, 2, 8, "interpolation time index", signed=True)
ACCELERATION_MAX = DictionaryObject(0x60C5, 0, 32, "max acceleration")
DECELERATION_MAX = DictionaryObject(0x60C6, 0, 32, "max deceleration")
SUPPORTED_MODES = DictionaryObject(0x6502, 0, 32, "supported drive modes")

MILLISECONDS = -3
"""The unit of `PERIOD`, by `PERIOD_INDEX`."""
PROFILE_POSITION_MODE = 1
HOMING_MODE = 6
INTERPOLATED_MODE = 7
CYCLIC_MODE = 8
FOLLOWED = {CYCLIC_MODE: TARGET, INTERPOLATED_MODE: INTERPOLATION_POSITION}
"""Modes in which a drive follows positions that come with SYNC, the preferred one first, and their object."""

FIRST_POINT_BIT = 16
"""Inputs and outputs 1 to 16 are the manufacturer-specific bits 16 to 31 of 60FDh and 60FEh."""


def point_bit(number: int) -> int:
    """Return the bit of input or output `number`."""
    return 1 << (FIRST_POINT_BIT + number - 1)


def _list_objects() -> Iterator[DictionaryObject]:
    for value in list(globals().values()):
        if isinstance(value, DictionaryObject):
            yield value
        elif isinstance(value, tuple):
            yield from (entry for entry in value if isinstance(entry, DictionaryObject))  # pyright: ignore[reportUnknownVariableType]


BY_ADDRESS = {(entry.index, entry.sub): entry for entry in _list_objects()}
"""The objects above, by index and sub-index."""


def read_mapping_entry(entry: int) -> DictionaryObject:
    """Return the object of an entry in a mapping parameter object; one that the adapter does not use has no name."""
    index, sub, bits = entry >> 16, entry >> 8 & 0xFF, entry & 0xFF
    known_object = BY_ADDRESS.get((index, sub))
    if known_object is not None and known_object.bits == bits:
        return known_object
    return DictionaryObject(index, sub, bits, "another object")
