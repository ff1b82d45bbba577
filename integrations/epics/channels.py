"""What a server of either protocol serves: a channel for each value, under its names."""

from dataclasses import dataclass

from integrations.epics.fields import FIELDS, Field, Value
from integrations.epics.record import JOGS, MotorRecord
from integrations.epics.values import Record
from tutti import Refusal


@dataclass(frozen=True, slots=True)
class Channel:
    """A value of a record. names: under which it is served. unit, digits, low, high: for a display."""

    names: tuple[str, ...]
    record: Record
    key: str
    field: Field
    unit: str = ""
    digits: int = 0
    low: float = 0.0
    high: float = 0.0

    @property
    def value(self) -> Value:
        """Its value now."""
        return self.record.values[self.key]

    @property
    def is_held(self) -> bool:
        """Whether what is put there ends with the connection of its client."""
        return self.key in JOGS


def make_channels(record: MotorRecord, name: str) -> list[Channel]:
    """The channels of the motor record `name`: `name.VAL`, which is `name` too, and so on."""
    values, egu = record.values, str(record.values["EGU"])
    units = {"egu": egu, "egu/s": f"{egu}/s", "s": "s"}
    return [
        Channel(
            (f"{name}.{key}", name) if key == "VAL" else (f"{name}.{key}",),
            record,
            key,
            field,
            units.get(field.unit, ""),
            int(values["PREC"]),
            *((float(values["LLM"]), float(values["HLM"])) if key in ("VAL", "RBV") else (0.0, 0.0)),
        )
        for key, field in FIELDS.items()
    ]


def refuse_address(protocol: str, interface: str) -> Refusal:
    """The refusal for an address at which a protocol cannot be served."""
    text = f"{protocol} cannot be served at {interface}: it is no address of this computer, or all its ports are in use"
    return Refusal("no-address", text, "choose another --interface")
