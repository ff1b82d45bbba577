"""The PDOs of a drive as data: what each carries, and which of them the adapter loads with and reads from."""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

from adapters.cia402.canopen.objects import ACTUAL, DEMAND, DictionaryObject


@dataclass(frozen=True, slots=True)
class PdoMapping:
    """One PDO: number from 1, function code, transmission type, mapped objects. inhibit, timer: None without one; in
    0.1 ms and ms. spare: objects that may be left out of it. is_fixed: the drive does not change what it carries."""

    title: str
    parameter: int
    mapping: int
    function: int
    kind: int
    carries: tuple[DictionaryObject, ...]
    inhibit: int | None = None
    timer: int | None = None
    spare: tuple[DictionaryObject, ...] = ()
    is_fixed: bool = False

    @property
    def is_received(self) -> bool:
        """Whether the drive receives it (RPDO)."""
        return self.title.startswith("RPDO")

    @property
    def essential(self) -> tuple[DictionaryObject, ...]:
        """Return the objects that may not be left out."""
        return tuple(obj for obj in self.carries if obj not in self.spare)

    @property
    def byte_size(self) -> int:
        """Return the length of its frame."""
        return sum(carried_object.bits for carried_object in self.carries) // 8

    def encode(self, values: Mapping[DictionaryObject, int]) -> bytes:
        return b"".join(carried_object.encode(values[carried_object]) for carried_object in self.carries)


@dataclass(frozen=True, slots=True)
class PdoReading:
    """What the adapter reads from a transmitted PDO: objects with their places in its frame of `byte_size`."""

    byte_size: int
    places: tuple[tuple[DictionaryObject, int], ...]

    def decode(self, data: bytes) -> dict[DictionaryObject, int]:
        return {obj: obj.decode(data[first:]) for obj, first in self.places}


@dataclass(frozen=True)
class PdoLayout:
    """The PDOs of a drive. absent: objects that it lacks. answer: title of the PDO that answers each SYNC of a stream,
    which does not show the present state."""

    pdos: tuple[PdoMapping, ...] = ()
    absent: frozenset[DictionaryObject] = frozenset()
    answer: str = ""

    @cached_property
    def readings(self) -> Mapping[int, PdoReading]:
        """By function code, what is read from each transmitted PDO. An object is read from one PDO only: another one
        may wait longer for the bus, and show an older state."""
        readings: dict[int, PdoReading] = {}
        known_objects: set[DictionaryObject] = set()
        for pdo in self.pdos:
            if pdo.is_received or pdo.title == self.answer:
                continue
            bit, places = 0, list[tuple[DictionaryObject, int]]()
            for obj in pdo.carries:
                # The commanded position is compared with the actual one of the same instant.
                if obj not in known_objects and (obj != DEMAND or ACTUAL in pdo.carries):
                    known_objects.add(obj)
                    places.append((obj, bit // 8))
                bit += obj.bits
            readings[pdo.function] = PdoReading(pdo.byte_size, tuple(places))
        return readings

    @cached_property
    def reported(self) -> frozenset[DictionaryObject]:
        """The objects that the drive sends by itself."""
        return frozenset(obj for reading in self.readings.values() for obj, _ in reading.places)

    def find_loading(self, objects: Mapping[DictionaryObject, int]) -> tuple[PdoMapping, ...]:
        """Return the received PDOs that carry nothing but some of `objects`, at once."""
        return tuple(
            pdo
            for pdo in self.pdos
            if pdo.is_received and pdo.carries and pdo.spare and all(obj in objects for obj in pdo.carries)
        )
