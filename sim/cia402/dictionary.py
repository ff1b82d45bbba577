"""The object dictionary of one drive: the content of its EDS file, and the present values.

Another EDS file may describe which of the objects the drive shows, and how: the firmware is the same.
"""

from collections.abc import Callable, Iterable, Mapping
from configparser import Error as IniError
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import cast

from canopen import ObjectDictionary, ObjectDictionaryError, import_od
from canopen.objectdictionary import ODVariable, datatypes

from sim.cia402 import aborts
from sim.cia402.aborts import SdoAbort

EDS = Path(__file__).with_name("drive.eds")

Key = tuple[int, int]

_SIZES = {
    datatypes.INTEGER8: (1, True),
    datatypes.INTEGER16: (2, True),
    datatypes.INTEGER32: (4, True),
    datatypes.UNSIGNED8: (1, False),
    datatypes.UNSIGNED16: (2, False),
    datatypes.UNSIGNED32: (4, False),
}


@dataclass(frozen=True, slots=True)
class ObjectEntry:
    """One variable as the EDS file describes it.

    size: bytes; 0 for a text, whose `default` it is."""

    size: int
    signed: bool
    readable: bool
    writable: bool
    mappable: bool
    default: int | bytes
    low: int | None
    high: int | None

    def encode_value(self, value: int) -> bytes:
        return value.to_bytes(self.size, "little", signed=self.signed)

    def decode_value(self, data: bytes) -> int:
        return int.from_bytes(data, "little", signed=self.signed)


_PDO_PARAMETERS, _PDO_MAPPINGS = (0x1400, 0x1800), (0x1600, 0x1A00)
_PDOS = range(0x1400, 0x1C00)
_PDO_COUNT = 4
_PDO_OFF = 0x8000_0000
_NODE = 0x7F  # of a COB-ID of the predefined connection set


@lru_cache(maxsize=128)
def _read_entries(node: int, path: str = str(EDS)) -> Mapping[Key, ObjectEntry]:
    """Read an EDS file. Raises `ValueError`."""
    try:
        dictionary: ObjectDictionary = import_od(path, node)
    except (OSError, IniError, ValueError, KeyError, AttributeError, ObjectDictionaryError) as error:
        raise ValueError(f"eds: {path} cannot be read: {error}") from None
    entries: dict[Key, ObjectEntry] = {}
    for index in cast(Iterable[int], dictionary):
        thing = dictionary[index]
        variables = [thing] if isinstance(thing, ODVariable) else cast(Iterable[ODVariable], thing.values())
        for variable in variables:
            entries[index, variable.subindex] = _build_entry(variable)
    return entries


def _build_entry(variable: ODVariable) -> ObjectEntry:
    size, is_signed = _SIZES.get(variable.data_type or 0, (0, False))
    access = variable.access_type
    default = variable.default
    return ObjectEntry(
        size=size,
        signed=is_signed,
        readable=access != "wo",
        writable=access in ("rw", "rww", "rwr", "wo"),
        mappable=bool(variable.pdo_mappable),
        default=str(default).encode() if size == 0 else int(default or 0),
        low=variable.min,
        high=variable.max,
    )


def _describe_pdos(described: Mapping[Key, ObjectEntry], node: int) -> dict[Key, int]:
    """Return the values of PDO parameters and mappings as a file describes them; PDOs that it lacks are off."""
    values = {
        key: entry.default for key, entry in described.items() if key[0] in _PDOS and isinstance(entry.default, int)
    }
    for parameters, mappings in zip(_PDO_PARAMETERS, _PDO_MAPPINGS, strict=True):
        for number in range(_PDO_COUNT):
            parameter, mapping = parameters + number, mappings + number
            cob = values.get((parameter, 1), 0)
            if not cob or (mapping, 0) not in described:
                values |= {(parameter, 1): _PDO_OFF, (mapping, 0): 0}
                continue
            # Files state the identifier of one node, or a formula.
            values[parameter, 1] = cob & ~_NODE | node
            entries = [values[mapping, sub] for sub in range(1, values[mapping, 0] + 1)]
            unknown = next((entry for entry in entries if (entry >> 16, entry >> 8 & 0xFF) not in described), None)
            if unknown is not None:
                raise ValueError(f"eds: {mapping:04X}h maps {unknown >> 16:04X}h, which the file lacks")
    return values


class DriveDictionary:
    """The objects of one drive.

    without: indices that are hidden from clients; the firmware uses their defaults.
    eds: path of the file that describes what clients see; None: the simulator's own.
    reads: sources of values that are not stored.
    writes: called with a value before it is stored; raises `SdoAbort` for a value that cannot be accepted.
    """

    def __init__(self, node: int, without: frozenset[int] = frozenset(), eds: str | None = None) -> None:
        entries = _read_entries(node, eds or str(EDS))
        self.entries = {key: entry for key, entry in entries.items() if key[0] not in without}
        self.reads: dict[Key, Callable[[], int]] = {}
        self.writes: dict[Key, Callable[[int], None]] = {}
        self._defaults = {
            key: entry.default
            for key, entry in {**entries, **_read_entries(node)}.items()
            if isinstance(entry.default, int)
        }
        if eds is not None:
            self._defaults |= _describe_pdos(entries, node)
        self._indices = {index for index, _ in self.entries}
        self._values: dict[Key, int] = {}
        self.reset_values({})

    def reset_values(self, kept: Mapping[Key, int]) -> None:
        """Set the values after power-up: the defaults, except those `kept` in the permanent memory."""
        self._values = {**self._defaults, **kept}

    def writable_values(self) -> dict[Key, int]:
        """Return the values that a client can change: the content of a permanent memory."""
        return {key: value for key, value in self._values.items() if key in self.entries and self.entries[key].writable}

    def get_value(self, index: int, sub: int = 0) -> int:
        reader = self.reads.get((index, sub))
        return self._values[index, sub] if reader is None else reader()

    def put_value(self, index: int, sub: int, value: int) -> None:
        """Store without checks."""
        self._values[index, sub] = value

    def is_writable(self, index: int, sub: int) -> bool:
        """Return whether clients can write an object."""
        entry = self.entries.get((index, sub))
        return entry is not None and entry.writable

    def has_object(self, index: int) -> bool:
        """Return whether clients see an object."""
        return index in self._indices

    def find_entry(self, index: int, sub: int) -> ObjectEntry:
        """Return the description of an object. Raises `SdoAbort`."""
        if index not in self._indices:
            raise SdoAbort(aborts.NO_OBJECT)
        entry = self.entries.get((index, sub))
        if entry is None:
            raise SdoAbort(aborts.NO_SUBINDEX)
        return entry

    def upload_value(self, index: int, sub: int) -> bytes:
        """Return the encoded value for a client. Raises `SdoAbort`."""
        entry = self.find_entry(index, sub)
        if not entry.readable:
            raise SdoAbort(aborts.WRITE_ONLY)
        return entry.default if isinstance(entry.default, bytes) else entry.encode_value(self.get_value(index, sub))

    def download_value(self, index: int, sub: int, data: bytes) -> None:
        """Accept an encoded value from a client. Raises `SdoAbort`."""
        entry = self.find_entry(index, sub)
        if not entry.writable:
            raise SdoAbort(aborts.READ_ONLY)
        if len(data) != entry.size:
            raise SdoAbort(aborts.TOO_LONG if len(data) > entry.size else aborts.TOO_SHORT)
        self.accept_value(index, sub, entry.decode_value(data))

    def accept_value(self, index: int, sub: int, value: int) -> None:
        """Check a value, apply it and store it. Raises `SdoAbort`."""
        entry = self.entries[index, sub]
        if entry.high is not None and value > entry.high:
            raise SdoAbort(aborts.TOO_HIGH)
        if entry.low is not None and value < entry.low:
            raise SdoAbort(aborts.TOO_LOW)
        write = self.writes.get((index, sub))
        if write is not None:
            write(value)
        self._values[index, sub] = value
