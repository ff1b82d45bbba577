"""The PDO mapping of a drive: its state arrives unsolicited, and commands take one frame.

RPDO 1 takes effect with the next SYNC and carries the start; RPDO 2 takes effect at once and carries all other commands
to the state machine; RPDO 3 and 4 carry a set-point. TPDO 1 is sent on change, the others with limited frequency. For a
drive that follows positions, RPDO 4 carries these, applied with each SYNC, and TPDO 4 answers each SYNC. Its outputs
travel with the positions, and not with the controlword of RPDO 1: so one SYNC never applies two values of them, and
positions that are under way do not enable a drive that was stopped.
"""

from dataclasses import dataclass

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.bus import RPDO, TPDO
from adapters.cia402.canopen.objects import DictionaryObject
from adapters.cia402.canopen.pdos import PdoMapping

SYNCHRONOUS, AT_ONCE = 1, 255


@dataclass(frozen=True, slots=True)
class PdoTimes:
    """How often the drive sends: at least each `state_ms`, positions at most each `inhibit_ms`."""

    state_ms: int = 50
    inhibit_ms: int = 10


@dataclass(frozen=True, slots=True)
class PdoNeeds:
    """What the fleet file asks of the PDOs. outputs, inputs: some are named. followed: the object of the positions that
    are streamed to the drive; None: none are."""

    times: PdoTimes = PdoTimes()
    outputs: bool = False
    inputs: bool = False
    followed: DictionaryObject | None = None

    def list_pdos(self) -> tuple[PdoMapping, ...]:
        """Return the PDOs of a drive that can map everything."""
        return required_pdos(self.times, outputs=self.outputs, followed=self.followed)


def list_all_pdos() -> tuple[PdoMapping, ...]:
    """Return all PDOs that the adapter may use, four each way."""
    return required_pdos(PdoTimes(), outputs=False, followed=o.TARGET)


def required_pdos(
    times: PdoTimes, *, outputs: bool, followed: DictionaryObject | None = None
) -> tuple[PdoMapping, ...]:
    """Return all PDOs of a drive. outputs: some are named. followed: the object of the positions that are streamed to
    it; None: none are."""
    output_objects = (o.OUTPUTS,) if outputs else ()
    start_objects = output_objects if followed is None else ()
    slow = times.inhibit_ms * 10
    fourth = (
        (
            PdoMapping(
                title="RPDO 4",
                parameter=0x1403,
                mapping=0x1603,
                function=RPDO[3],
                kind=AT_ONCE,
                carries=(o.ACCELERATION, o.DECELERATION),
                spare=(o.ACCELERATION, o.DECELERATION),
            ),
        )
        if followed is None
        else (
            PdoMapping(
                title="RPDO 4",
                parameter=0x1403,
                mapping=0x1603,
                function=RPDO[3],
                kind=SYNCHRONOUS,
                carries=(followed, *output_objects),
            ),
            PdoMapping(
                title="TPDO 4",
                parameter=0x1803,
                mapping=0x1A03,
                function=TPDO[3],
                kind=SYNCHRONOUS,
                carries=(o.STATUSWORD, o.DEMAND),
            ),
        )
    )
    return (
        PdoMapping(
            title="RPDO 1",
            parameter=0x1400,
            mapping=0x1600,
            function=RPDO[0],
            kind=SYNCHRONOUS,
            carries=(o.CONTROLWORD, *start_objects),
        ),
        PdoMapping(
            title="RPDO 2",
            parameter=0x1401,
            mapping=0x1601,
            function=RPDO[1],
            kind=AT_ONCE,
            carries=(o.CONTROLWORD, o.MODE, *output_objects),
        ),
        PdoMapping(
            title="RPDO 3",
            parameter=0x1402,
            mapping=0x1602,
            function=RPDO[2],
            kind=AT_ONCE,
            carries=(o.TARGET, o.PROFILE_VELOCITY),
            spare=(o.TARGET, o.PROFILE_VELOCITY),
        ),
        PdoMapping(
            title="TPDO 1",
            parameter=0x1800,
            mapping=0x1A00,
            function=TPDO[0],
            kind=AT_ONCE,
            carries=(o.STATUSWORD, o.MODE_DISPLAY),
            spare=(o.MODE_DISPLAY,),
            inhibit=0,
            timer=times.state_ms,
        ),
        PdoMapping(
            title="TPDO 2",
            parameter=0x1801,
            mapping=0x1A01,
            function=TPDO[1],
            kind=AT_ONCE,
            carries=(o.DEMAND, o.ACTUAL),
            spare=(o.DEMAND,),
            inhibit=slow,
            timer=times.state_ms,
        ),
        PdoMapping(
            title="TPDO 3",
            parameter=0x1802,
            mapping=0x1A02,
            function=TPDO[2],
            kind=AT_ONCE,
            carries=(o.INPUTS, o.VELOCITY),
            spare=(o.INPUTS, o.VELOCITY),
            inhibit=slow,
            timer=times.state_ms,
        ),
        *fourth,
    )
