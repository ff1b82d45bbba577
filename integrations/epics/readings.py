"""An axis as it was read, and what of it the alarm and the status bits of a record are."""

from dataclasses import dataclass

from integrations.epics.fields import SEVERITIES, STATES


@dataclass(frozen=True, slots=True)
class AxisReading:
    """An axis as it was read. position, commanded: user; offset: of these to the dial. utc_s: when; fleet_ns: the same
    for the order of readings, None if it is not known."""

    position: float
    commanded: float
    offset: float = 0.0
    moving: bool = False
    enabled: bool = True
    referenced: bool = True
    limit: str = "none"
    fault: str = ""
    online: bool = True
    utc_s: float | None = None
    fleet_ns: int | None = None


@dataclass(frozen=True, slots=True)
class Alarm:
    """The alarm of a record. severity, status: numbers of `SEVERITIES` and `STATES`. text: why."""

    severity: int = 0
    status: int = 0
    text: str = ""

    @classmethod
    def of(cls, severity: str, status: str, text: str) -> "Alarm":
        """An alarm by its names."""
        return cls(SEVERITIES.index(severity), STATES.index(status), text)


def find_alarm(reading: AxisReading, problem: str) -> Alarm:
    """The alarm of a record. problem: why the last move was not done."""
    if not reading.online:
        return Alarm.of("INVALID", "COMM", "its controller is offline")
    if reading.fault:
        return Alarm.of("MAJOR", "STATE", reading.fault)
    return Alarm.of("MINOR", "WRITE", problem) if problem else Alarm()


def find_msta(reading: AxisReading, *, is_forward: bool) -> int:
    """MSTA, by the bits of motorRecord.html: 1 the direction, 2 done, and so on."""
    bits = {
        0: is_forward,
        1: not reading.moving,
        2: reading.limit in ("forward", "both"),
        5: reading.enabled,
        9: bool(reading.fault),
        10: reading.moving,
        11: True,
        12: not reading.online,
        13: reading.limit in ("reverse", "both"),
        14: reading.referenced,
    }
    return sum(1 << bit for bit, is_set in bits.items() if is_set)
