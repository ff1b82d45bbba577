"""Texts of the CANopen codes: SDO abort codes (CiA 301), emergency error codes (CiA 301 and CiA 402)."""

ABORTS = {
    0x0503_0000: "toggle bit not alternated",
    0x0504_0000: "SDO protocol timed out",
    0x0504_0001: "command specifier not valid or unknown",
    0x0504_0002: "invalid block size",
    0x0504_0003: "invalid sequence number",
    0x0504_0004: "CRC error",
    0x0504_0005: "out of memory",
    0x0601_0000: "unsupported access to an object",
    0x0601_0001: "attempt to read a write only object",
    0x0601_0002: "attempt to write a read only object",
    0x0602_0000: "object does not exist in the object dictionary",
    0x0604_0041: "object cannot be mapped to the PDO",
    0x0604_0042: "the mapped objects would exceed the PDO's length",
    0x0604_0043: "general parameter incompatibility",
    0x0604_0047: "general internal incompatibility in the device",
    0x0606_0000: "access failed due to a hardware error",
    0x0607_0010: "data type does not match, length of parameter does not match",
    0x0607_0012: "data type does not match, length of parameter too high",
    0x0607_0013: "data type does not match, length of parameter too low",
    0x0609_0011: "sub-index does not exist",
    0x0609_0030: "invalid value for parameter",
    0x0609_0031: "value of parameter written too high",
    0x0609_0032: "value of parameter written too low",
    0x0609_0036: "maximum value is less than minimum value",
    0x060A_0023: "resource not available: SDO connection",
    0x0800_0000: "general error",
    0x0800_0020: "data cannot be transferred or stored to the application",
    0x0800_0021: "data cannot be transferred or stored because of local control",
    0x0800_0022: "data cannot be transferred or stored because of the present device state",
    0x0800_0023: "object dictionary generation failed, or no object dictionary is present",
    0x0800_0024: "no data available",
}
NO_OBJECT = 0x0602_0000
NO_SUBINDEX = 0x0609_0011
NOT_THERE = frozenset({NO_OBJECT, NO_SUBINDEX})
"""Abort codes of a device without the object."""
WRITE_ONLY, READ_ONLY = 0x0601_0001, 0x0601_0002
FIXED = frozenset({READ_ONLY, 0x0601_0000})
"""Abort codes of a mapping that cannot be changed."""
NOT_MAPPABLE = 0x0604_0041
WRONG_STATE = 0x0800_0022
TIMED_OUT = 0x0504_0000

_EMERGENCIES = {
    0x2310: "continuous over current",
    0x2320: "short circuit or earth leakage",
    0x3110: "mains over-voltage",
    0x3120: "mains under-voltage",
    0x3130: "phase failure",
    0x3210: "DC link over-voltage",
    0x3220: "DC link under-voltage",
    0x4210: "excess temperature of the device",
    0x4310: "excess temperature of the drive",
    0x5441: "the enable input is off",
    0x6320: "parameter error",
    0x7121: "motor blocked",
    0x7300: "sensor error",
    0x7305: "incremental sensor 1 fault",
    0x8110: "CAN overrun, objects lost",
    0x8120: "CAN in error passive mode",
    0x8130: "life guard or heartbeat error",
    0x8140: "recovered from bus-off",
    0x8150: "CAN identifier collision",
    0x8210: "PDO not processed due to a length error",
    0x8220: "PDO length exceeded",
    0x8240: "unexpected SYNC data length",
    0x8250: "RPDO timeout",
    0x8611: "following error",
    0x8612: "reference limit",
    0x8613: "homing error",
    0x8700: "SYNC lost",
    0xFF00: "a manufacturer-specific error",
}
# By class (the upper byte), for codes that are not listed individually (CiA 301, table of emergency error codes).
_CLASSES = {
    0x10: "generic error",
    0x20: "current",
    0x21: "current, device input side",
    0x22: "current inside the device",
    0x23: "current, device output side",
    0x30: "voltage",
    0x31: "mains voltage",
    0x32: "voltage inside the device",
    0x33: "output voltage",
    0x40: "temperature",
    0x41: "ambient temperature",
    0x42: "device temperature",
    0x50: "device hardware",
    0x60: "device software",
    0x61: "internal software",
    0x62: "user software",
    0x63: "data set",
    0x70: "additional modules",
    0x80: "monitoring",
    0x81: "communication",
    0x82: "protocol error",
    0x86: "positioning",
    0x90: "external error",
    0xF0: "additional functions",
    0xFF: "a manufacturer-specific error",
}


def abort_text(code: int) -> str:
    """Return the text of an SDO abort code."""
    return f"{ABORTS.get(code, 'an abort code that CiA 301 does not list')} ({code:08X}h)"


def emergency_text(code: int) -> str:
    """Return the text of an emergency error code."""
    error_name = _EMERGENCIES.get(code) or _CLASSES.get(code >> 8) or _CLASSES.get(code >> 8 & 0xF0) or "unknown error"
    return f"{error_name} ({code:04X}h)"
