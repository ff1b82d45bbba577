"""The object dictionary of one drive: what its EDS file says, and the values that it has now."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import cast

from canopen import ObjectDictionary, import_od
from canopen.objectdictionary import ODVariable, datatypes

from sim.cia402 import aborts
from sim.cia402.aborts import Abort

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
class Entry:
    """One variable as the EDS file describes it. size: bytes; 0 for a text, whose `default` it is."""

    size: int
    signed: bool
    readable: bool
    writable: bool
    mappable: bool
    default: int | bytes
    low: int | None
    high: int | None

    def encode(self, value: int) -> bytes:
        return value.to_bytes(self.size, "little", signed=self.signed)

    def decode(self, data: bytes) -> int:
        return int.from_bytes(data, "little", signed=self.signed)


@lru_cache(maxsize=128)
def _entries(node: int) -> Mapping[Key, Entry]:
    dictionary: ObjectDictionary = import_od(str(EDS), node)
    found: dict[Key, Entry] = {}
    for index in cast(Iterable[int], dictionary):
        thing = dictionary[index]
        variables = [thing] if isinstance(thing, ODVariable) else cast(Iterable[ODVariable], thing.values())
        for variable in variables:
            found[index, variable.subindex] = _entry(variable)
    return found


def _entry(variable: ODVariable) -> Entry:
    size, signed = _SIZES.get(variable.data_type or 0, (0, False))
    access = variable.access_type
    default = variable.default
    return Entry(
        size=size,
        signed=signed,
        readable=access != "wo",
        writable=access in ("rw", "rww", "rwr", "wo"),
        mappable=bool(variable.pdo_mappable),
        default=str(default).encode() if size == 0 else int(default or 0),
        low=variable.min,
        high=variable.max,
    )


class Dictionary:
    """The objects of one drive. without: indices that clients do not find; its firmware has their defaults.

    reads: where values come from that are not stored. writes: called with a value before it is stored; raises `Abort`
    for one that can not be taken.
    """

    def __init__(self, node: int, without: frozenset[int] = frozenset()) -> None:
        self.entries = {key: entry for key, entry in _entries(node).items() if key[0] not in without}
        self.reads: dict[Key, Callable[[], int]] = {}
        self.writes: dict[Key, Callable[[int], None]] = {}
        self._defaults = {key: each.default for key, each in _entries(node).items() if isinstance(each.default, int)}
        self._indices = {index for index, _ in self.entries}
        self._values: dict[Key, int] = {}
        self.reset({})

    def reset(self, kept: Mapping[Key, int]) -> None:
        """Values as after power-up: the defaults, but for those that are `kept` in the permanent memory."""
        self._values = {**self._defaults, **kept}

    def writable(self) -> dict[Key, int]:
        """The values that a client can have changed: what a permanent memory keeps."""
        return {key: value for key, value in self._values.items() if key in self.entries and self.entries[key].writable}

    def get(self, index: int, sub: int = 0) -> int:
        read = self.reads.get((index, sub))
        return self._values[index, sub] if read is None else read()

    def put(self, index: int, sub: int, value: int) -> None:
        """Store without asking."""
        self._values[index, sub] = value

    def entry(self, index: int, sub: int) -> Entry:
        """Raises `Abort`."""
        if index not in self._indices:
            raise Abort(aborts.NO_OBJECT)
        found = self.entries.get((index, sub))
        if found is None:
            raise Abort(aborts.NO_SUBINDEX)
        return found

    def upload(self, index: int, sub: int) -> bytes:
        """The value as it goes to a client. Raises `Abort`."""
        entry = self.entry(index, sub)
        if not entry.readable:
            raise Abort(aborts.WRITE_ONLY)
        return entry.default if isinstance(entry.default, bytes) else entry.encode(self.get(index, sub))

    def download(self, index: int, sub: int, data: bytes) -> None:
        """Take a value from a client. Raises `Abort`."""
        entry = self.entry(index, sub)
        if not entry.writable:
            raise Abort(aborts.READ_ONLY)
        if len(data) != entry.size:
            raise Abort(aborts.TOO_LONG if len(data) > entry.size else aborts.TOO_SHORT)
        self.take(index, sub, entry.decode(data))

    def take(self, index: int, sub: int, value: int) -> None:
        """Check, act and store. Raises `Abort`."""
        entry = self.entries[index, sub]
        if entry.high is not None and value > entry.high:
            raise Abort(aborts.TOO_HIGH)
        if entry.low is not None and value < entry.low:
            raise Abort(aborts.TOO_LOW)
        write = self.writes.get((index, sub))
        if write is not None:
            write(value)
        self._values[index, sub] = value
