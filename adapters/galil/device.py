"""A Galil controller on its handles: identified by its revision text, with the record of its family."""

from adapters.galil.models import MAX_AXES, GalilFamily, identify_family
from adapters.yaskawa.common.device import SmcDevice
from adapters.yaskawa.common.program import program_lines
from adapters.yaskawa.wire.record import RecordFormat
from adapters.yaskawa.wire.session import CommandSession


class GalilDevice(SmcDevice):
    """One controller. family: which it is, known since `connect`."""

    family: GalilFamily | None = None

    async def _find_format(self, session: CommandSession, revision: str) -> RecordFormat:
        # Not by QZ: its number of axes is not reliable (GalilController.cpp, where its answer is ignored).
        del session
        self.family, axes = identify_family(revision)
        return self.family.make_format(min(axes, MAX_AXES))

    def _make_program(self) -> tuple[str, ...]:
        return program_lines(self.record_format.axes, self.gate, contours=False, probes=False)
