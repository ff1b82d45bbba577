"""The PDO mapping of a drive: its state arrives unsolicited, and commands take one frame.

RPDO 1 takes effect with the next SYNC and carries the start; RPDO 2 takes effect at once and carries all other commands
to the state machine; RPDO 3 and 4 carry a set-point. TPDO 1 is sent on change, the others with limited frequency. For a
drive that follows positions, RPDO 4 carries these, applied with each SYNC, and TPDO 4 answers each SYNC. Its outputs
travel with the positions, and not with the controlword of RPDO 1: so one SYNC never applies two values of them, and
positions that are under way do not enable a drive that was stopped.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.bus import RPDO, TPDO
from adapters.cia402.canopen.objects import DictionaryObject
from adapters.cia402.canopen.sdo import SdoAborted, SdoClient
from adapters.cia402.canopen.words import NOT_THERE, WRONG_STATE, abort_text
from adapters.cia402.options import Cia402Options
from orchestrator.model.errors import ControllerFault, TuttiError

_OFF = 1 << 31
_COB_MASK = 0x7FF
SYNCHRONOUS, AT_ONCE = 1, 255


class MappingNotAllowed(TuttiError):
    """The drive accepts no mapping in its present NMT state."""


@dataclass(frozen=True, slots=True)
class PdoMapping:
    """One PDO: number from 1, function code, transmission type, mapped objects. inhibit, timer: None without one; in
    0.1 ms and ms."""

    title: str
    parameter: int
    mapping: int
    function: int
    kind: int
    carries: tuple[DictionaryObject, ...]
    inhibit: int | None = None
    timer: int | None = None


def required_pdos(
    options: Cia402Options, *, outputs: bool, followed: DictionaryObject | None = None
) -> tuple[PdoMapping, ...]:
    """Return all PDOs of a drive. outputs: some are named. followed: the object of the positions that are streamed to
    it; None: none are."""
    output_objects = (o.OUTPUTS,) if outputs else ()
    start_objects = output_objects if followed is None else ()
    slow = options.inhibit_ms * 10
    fourth = (
        (
            PdoMapping(
                title="RPDO 4",
                parameter=0x1403,
                mapping=0x1603,
                function=RPDO[3],
                kind=AT_ONCE,
                carries=(o.ACCELERATION, o.DECELERATION),
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
        ),
        PdoMapping(
            title="TPDO 1",
            parameter=0x1800,
            mapping=0x1A00,
            function=TPDO[0],
            kind=AT_ONCE,
            carries=(o.STATUSWORD, o.MODE_DISPLAY),
            inhibit=0,
            timer=options.state_ms,
        ),
        PdoMapping(
            title="TPDO 2",
            parameter=0x1801,
            mapping=0x1A01,
            function=TPDO[1],
            kind=AT_ONCE,
            carries=(o.DEMAND, o.ACTUAL),
            inhibit=slow,
            timer=options.state_ms,
        ),
        PdoMapping(
            title="TPDO 3",
            parameter=0x1802,
            mapping=0x1A02,
            function=TPDO[2],
            kind=AT_ONCE,
            carries=(o.INPUTS, o.VELOCITY),
            inhibit=slow,
            timer=options.state_ms,
        ),
        *fourth,
    )


def parameter_values(pdo: PdoMapping, node: int) -> list[tuple[DictionaryObject, int]]:
    """Return the objects that describe a PDO, each with its required value."""
    times = [(_parameter_object(pdo, sub, 16), value) for sub, value in ((3, pdo.inhibit), (5, pdo.timer)) if value]
    return [
        (_parameter_object(pdo, 1, 32), pdo.function + node),
        (_parameter_object(pdo, 2, 8), pdo.kind),
        *times,
        (_mapping_object(pdo, 0, 8), len(pdo.carries)),
        *(
            (_mapping_object(pdo, number, 32), carried_object.mapping_entry)
            for number, carried_object in enumerate(pdo.carries, start=1)
        ),
    ]


def pdo_value(obj: DictionaryObject, value: int) -> int:
    """Return the part of a value that `parameter_values` states: a COB-ID has further flags (no remote request)."""
    return value & (_OFF | _COB_MASK) if obj.sub == 1 and obj.name.startswith("COB-ID") else value


async def map_all(sdo: SdoClient, node: int, name: str, wanted: Sequence[PdoMapping]) -> bool:
    """Map the PDOs that differ from `wanted`, and read them back; return whether any differed. Raises
    `MappingNotAllowed`, `ControllerFault`."""
    is_changed = False
    for pdo in wanted:
        if await _is_mapped(sdo, node, pdo):
            continue
        is_changed = True
        await _map_pdo(sdo, node, name, pdo)
        if not await _is_mapped(sdo, node, pdo):
            objects_text = ", ".join(str(carried_object) for carried_object in pdo.carries)
            raise ControllerFault(
                "pdo-mapping",
                f"{name} has accepted a mapping for {pdo.title} and does not store it: wanted {objects_text}",
                "is another master on the bus? Is the mapping fixed? See the drive's manual",
            )
    return is_changed


async def _is_mapped(sdo: SdoClient, node: int, pdo: PdoMapping) -> bool:
    parameter, count = _parameter_object(pdo, 1, 32), _mapping_object(pdo, 0, 8)
    try:
        cob = await sdo.read_value(parameter)
        if (
            cob & (_OFF | _COB_MASK) != pdo.function + node
            or await sdo.read_value(_parameter_object(pdo, 2, 8)) != pdo.kind
        ):
            return False
        if await sdo.read_value(count) != len(pdo.carries):
            return False
        for number, carried_object in enumerate(pdo.carries, start=1):
            if await sdo.read_value(_mapping_object(pdo, number, 32)) != carried_object.mapping_entry:
                return False
    except SdoAborted as error:
        if error.abort not in NOT_THERE:
            raise
        return False
    return await _set_times(sdo, pdo)


async def _set_times(sdo: SdoClient, pdo: PdoMapping) -> bool:
    """Set its times, which a drive need not support."""
    for sub, value in ((3, pdo.inhibit), (5, pdo.timer)):
        if value is not None:
            try:
                if await sdo.read_value(_parameter_object(pdo, sub, 16)) != value:
                    return False
            except SdoAborted as error:
                if error.abort not in NOT_THERE:
                    raise
    return True


async def _map_pdo(sdo: SdoClient, node: int, name: str, pdo: PdoMapping) -> None:
    """Map a PDO in the order that CiA 301 prescribes: switch off, clear, fill, count, switch on."""
    cob = pdo.function + node
    step_text = pdo.title
    try:
        await sdo.write_value(_parameter_object(pdo, 1, 32), cob | _OFF)
        await sdo.write_value(_parameter_object(pdo, 2, 8), pdo.kind)
        for sub, value in ((3, pdo.inhibit), (5, pdo.timer)):
            if value is not None:
                await _write_if_there(sdo, _parameter_object(pdo, sub, 16), value)
        await sdo.write_value(_mapping_object(pdo, 0, 8), 0)
        for number, carried_object in enumerate(pdo.carries, start=1):
            step_text = f"{pdo.title}, {carried_object}"
            await sdo.write_value(_mapping_object(pdo, number, 32), carried_object.mapping_entry)
        step_text = pdo.title
        await sdo.write_value(_mapping_object(pdo, 0, 8), len(pdo.carries))
        await sdo.write_value(_parameter_object(pdo, 1, 32), cob)
    except SdoAborted as error:
        if error.abort == WRONG_STATE:
            raise MappingNotAllowed from None
        raise ControllerFault(
            "pdo-mapping",
            f"{name} refuses the mapping of {step_text}: {abort_text(error.abort)}",
            "does the drive allow this object in a PDO, and mapping at all? Compare its EDS file and its manual",
        ) from None


async def _write_if_there(sdo: SdoClient, obj: DictionaryObject, value: int) -> None:
    try:
        await sdo.write_value(obj, value)
    except SdoAborted as error:
        if error.abort not in NOT_THERE:
            raise


def _parameter_object(pdo: PdoMapping, sub: int, bits: int) -> DictionaryObject:
    names = {1: "COB-ID", 2: "transmission type", 3: "inhibit time", 5: "event timer"}
    return DictionaryObject(pdo.parameter, sub, bits, f"{names[sub]} of {pdo.title}")


def _mapping_object(pdo: PdoMapping, sub: int, bits: int) -> DictionaryObject:
    return DictionaryObject(pdo.mapping, sub, bits, f"mapping of {pdo.title}")
