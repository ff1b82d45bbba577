"""The two families of controllers that the adapter knows: how they differ from each other and from the SMC-4000.

Sources: `gclib_record.h` (records, by Galil), the EPICS driver motorapp/Galil-3-0 at be947ca (`GalilController.cpp`:
identification and number of axes in `connected`, largest acceleration), tmtsoftware/galil-prototype at 00b26a4
(`DataRecord.scala`: order of the header's bytes), the DMC-40x0 command reference (QZ).
"""

import re
from dataclasses import dataclass, replace

from adapters.yaskawa.shapes.model import SMC4000, ModelTraits
from adapters.yaskawa.wire.record import RecordFormat
from orchestrator.model.errors import ControllerFault

MAX_AXES = 4
"""Axes A to D: the resident program has an entry for each set of axes, and its memory ends there."""

_BLOCKS_OF_I = 0x84  # first byte of the header: always 80h, and the general block (DataRecord.scala)


@dataclass(frozen=True, slots=True)
class GalilFamily:
    """A family of models. name: as people write it. pattern: of the revision text, with the number of axes. blocks: of
    its record, see `RecordFormat.from_blocks`."""

    name: str
    pattern: re.Pattern[str]
    blocks: tuple[str, str]
    traits: ModelTraits

    def make_format(self, axes: int) -> RecordFormat:
        """Return the layout of the record with the general block and the first `axes` axes."""
        return RecordFormat.from_blocks(axes, self.blocks, bytes((_BLOCKS_OF_I, (1 << axes) - 1)))


_NO_CONTOURS = replace(SMC4000, contours=False)

DMC21X3 = GalilFamily(
    "DMC-21x3",
    re.compile(r"DMC21([1-8])3\b"),
    # gclib_record.h, GDataRecord2103: as the SMC-4000's, with an analog input at the end of each axis block.
    ("H10s10sBB", "HBBiiiiih2x"),
    _NO_CONTOURS,
)
DMC40X0 = GalilFamily(
    "DMC-40x0",
    re.compile(r"DMC40([1-8])0\b"),
    # gclib_record.h, GDataRecord4000: reserved words and handles before error code and threads, the amplifiers after
    # them; a long torque, then analog input, halls, and a variable of the user.
    ("H10s10s24xBB4x", "HBBiiiiii8x"),
    replace(_NO_CONTOURS, ramp_max=1_073_740_800),  # GalilController.cpp, maxAcceleration_
)
FAMILIES = (DMC21X3, DMC40X0)


def identify_family(revision: str) -> tuple[GalilFamily, int]:
    """Return the family and the number of axes from the answer to ctrl-R ctrl-V. Raises `ControllerFault`."""
    for family in FAMILIES:
        family_match = family.pattern.search(revision)
        if family_match:
            return family, int(family_match[1])
    known_families = " and ".join(family.name for family in FAMILIES)
    raise ControllerFault(
        "other-model",
        f"the controller calls itself {revision[:60]!r}; this adapter knows {known_families}",
        "correct `adapter` or the address in the fleet file",
    )
