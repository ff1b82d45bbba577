"""Permanent memory of the objects (0x1010, 0x1011)."""

from sim.cia402 import aborts
from sim.cia402.aborts import SdoAbort
from sim.cia402.dictionary import DriveDictionary
from sim.cia402.options import DriveOptions

_SAVE, _LOAD = 0x6576_6173, 0x6461_6F6C
_NOT_KEPT = (0x1003, 0x1010, 0x1011, 0x1013, 0x6040)


class PermanentObjects:
    """Values that objects have after a start. Raises `ValueError` for an option that names no object."""

    def __init__(self, dictionary: DriveDictionary, options: DriveOptions) -> None:
        self._dictionary = dictionary
        self._delivered = {_parse_key(name): value for name, value in options.objects.items()}
        unknown = next((name for name in options.objects if _parse_key(name) not in dictionary.entries), None)
        if unknown is not None:
            raise ValueError(f"objects: {unknown} is not an object of the drive; see its EDS file")
        self.kept = dict(self._delivered)

    def save_objects(self, signature: int) -> None:
        """Handle a write to 0x1010: keep the present values."""
        if signature != _SAVE:
            raise SdoAbort(aborts.NOT_STORED)
        kept_values = self._dictionary.writable_values()
        self.kept = {key: value for key, value in kept_values.items() if key[0] not in _NOT_KEPT}

    def load_objects(self, signature: int) -> None:
        """Handle a write to 0x1011: from the next start on, the values as delivered."""
        if signature != _LOAD:
            raise SdoAbort(aborts.NOT_STORED)
        self.kept = dict(self._delivered)


def _parse_key(name: str) -> tuple[int, int]:
    """Parse `6091:1` as index and sub-index."""
    index, _, sub = name.partition(":")
    return int(index, 16), int(sub or "0", 16)
