"""Touch probes: inputs that capture the position (CiA 402-2, objects 60B8h to 60BDh)."""

from collections.abc import Callable

from sim.cia402 import aborts
from sim.cia402.aborts import SdoAbort
from sim.cia402.dictionary import DriveDictionary
from sim.cia402.options import DriveOptions

FUNCTION, STATUS = 0x60B8, 0x60B9
_ON, _CONTINUOUS, _SOURCE, _POSITIVE, _NEGATIVE = 0x01, 0x02, 0x0C, 0x10, 0x20
_PROBE = 0xFF
# Of a probe's byte in the status: an edge's position is stored one bit above "switched on", or two.
_STORED = {_POSITIVE: 0x02, _NEGATIVE: 0x04}
_POSITIONS = ({_POSITIVE: 0x60BA, _NEGATIVE: 0x60BB}, {_POSITIVE: 0x60BC, _NEGATIVE: 0x60BD})


class TouchProbes:
    """The two touch probes of a drive: the low byte of 60B8h and 60B9h is of the first one.

    An edge is taken once after it was switched on, or each time with the bit for that. Its position stays readable when
    the probe is switched off; that it is stored does not.
    """

    def __init__(
        self,
        dictionary: DriveDictionary,
        options: DriveOptions,
        read_position: Callable[[], int],
        changed: Callable[[], None],
    ) -> None:
        self._dictionary = dictionary
        self._inputs = options.probe_inputs
        self._read_position = read_position
        self._changed = changed
        dictionary.writes[FUNCTION, 0] = self._set_function

    def switch_off(self) -> None:
        """Forget what was asked for and stored: the firmware starts."""
        for index in (FUNCTION, STATUS, *_POSITIONS[0].values(), *_POSITIONS[1].values()):
            self._dictionary.put_value(index, 0, 0)

    def handle_input(self, number: int, *, level: bool) -> None:
        """Capture the position at an edge of an input, if a probe waits for it."""
        edge = _POSITIVE if level else _NEGATIVE
        word, status = self._dictionary.get_value(FUNCTION), self._dictionary.get_value(STATUS)
        for probe, wired_input in enumerate(self._inputs):
            probe_word, store_bit = word >> 8 * probe & _PROBE, _STORED[edge] << 8 * probe
            is_taken = bool(status & store_bit) and not probe_word & _CONTINUOUS
            if wired_input == number and probe_word & _ON and probe_word & edge and not is_taken:
                self._dictionary.put_value(_POSITIONS[probe][edge], 0, self._read_position())
                self._dictionary.put_value(STATUS, 0, status | store_bit)
                self._changed()

    def _set_function(self, word: int) -> None:
        """Object 60B8h. Zero impulse and 60D0h are no sources of this drive, nor is an input that it does not have."""
        status = self._dictionary.get_value(STATUS)
        for probe in range(len(_POSITIONS)):
            probe_word = word >> 8 * probe & _PROBE
            if probe_word & _ON and (probe_word & _SOURCE or probe >= len(self._inputs)):
                raise SdoAbort(aborts.RANGE)
        for probe in range(len(_POSITIONS)):
            probe_word = word >> 8 * probe & _PROBE
            keep_bits = (
                sum(store_bit for edge, store_bit in _STORED.items() if probe_word & edge) if probe_word & _ON else 0
            )
            on = _ON if probe_word & _ON else 0
            status = status & ~(_PROBE << 8 * probe) | (status & keep_bits << 8 * probe) | on << 8 * probe
        self._dictionary.put_value(STATUS, 0, status)
        self._changed()
