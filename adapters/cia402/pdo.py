"""The PDO mapping of a drive: its state arrives unsolicited, and commands take one frame.

RPDO 1 takes effect with the next SYNC and carries the start; RPDO 2 takes effect at once and carries all other commands
to the state machine; RPDO 3 and 4 carry a set-point. TPDO 1 is sent on change, the others with limited frequency. For a
drive that follows positions, RPDO 4 carries these, applied with each SYNC, and TPDO 4 answers each SYNC. Its outputs
travel with the positions, and not with the controlword of RPDO 1: so one SYNC never applies two values of them, and
positions that are under way do not enable a drive that was stopped.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from adapters.cia402 import objects as o
from adapters.cia402.bus import RPDO, TPDO
from adapters.cia402.objects import DictionaryObject
from adapters.cia402.options import Cia402Options
from adapters.cia402.sdo import SdoAborted, SdoClient
from adapters.cia402.words import NOT_THERE, WRONG_STATE, abort_text
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
    switched = (o.OUTPUTS,) if outputs else ()
    started = switched if followed is None else ()
    slow = options.inhibit_ms * 10
    fourth = (
        (PdoMapping("RPDO 4", 0x1403, 0x1603, RPDO[3], AT_ONCE, (o.ACCELERATION, o.DECELERATION)),)
        if followed is None
        else (
            PdoMapping("RPDO 4", 0x1403, 0x1603, RPDO[3], SYNCHRONOUS, (followed, *switched)),
            PdoMapping("TPDO 4", 0x1803, 0x1A03, TPDO[3], SYNCHRONOUS, (o.STATUSWORD, o.DEMAND)),
        )
    )
    return (
        PdoMapping("RPDO 1", 0x1400, 0x1600, RPDO[0], SYNCHRONOUS, (o.CONTROLWORD, *started)),
        PdoMapping("RPDO 2", 0x1401, 0x1601, RPDO[1], AT_ONCE, (o.CONTROLWORD, o.MODE, *switched)),
        PdoMapping("RPDO 3", 0x1402, 0x1602, RPDO[2], AT_ONCE, (o.TARGET, o.PROFILE_VELOCITY)),
        PdoMapping("TPDO 1", 0x1800, 0x1A00, TPDO[0], AT_ONCE, (o.STATUSWORD, o.MODE_DISPLAY), 0, options.state_ms),
        PdoMapping("TPDO 2", 0x1801, 0x1A01, TPDO[1], AT_ONCE, (o.DEMAND, o.ACTUAL), slow, options.state_ms),
        PdoMapping("TPDO 3", 0x1802, 0x1A02, TPDO[2], AT_ONCE, (o.INPUTS, o.VELOCITY), slow, options.state_ms),
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
        *((_mapping_object(pdo, number, 32), each.mapping_entry) for number, each in enumerate(pdo.carries, start=1)),
    ]


def pdo_value(obj: DictionaryObject, value: int) -> int:
    """Return the part of a value that `parameter_values` states: a COB-ID has further flags (no remote request)."""
    return value & (_OFF | _COB_MASK) if obj.sub == 1 and obj.name.startswith("COB-ID") else value


async def map_all(sdo: SdoClient, node: int, name: str, wanted: Sequence[PdoMapping]) -> bool:
    """Map the PDOs that differ from `wanted`, and read them back; return whether any differed. Raises
    `MappingNotAllowed`, `ControllerFault`."""
    changed = False
    for pdo in wanted:
        if await _is_mapped(sdo, node, pdo):
            continue
        changed = True
        await _map_pdo(sdo, node, name, pdo)
        if not await _is_mapped(sdo, node, pdo):
            carried = ", ".join(str(each) for each in pdo.carries)
            raise ControllerFault(
                "pdo-mapping",
                f"{name} has accepted a mapping for {pdo.title} and does not store it: wanted {carried}",
                "is another master on the bus? Is the mapping fixed? See the drive's manual",
            )
    return changed


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
        for number, each in enumerate(pdo.carries, start=1):
            if await sdo.read_value(_mapping_object(pdo, number, 32)) != each.mapping_entry:
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
    doing = pdo.title
    try:
        await sdo.write_value(_parameter_object(pdo, 1, 32), cob | _OFF)
        await sdo.write_value(_parameter_object(pdo, 2, 8), pdo.kind)
        for sub, value in ((3, pdo.inhibit), (5, pdo.timer)):
            if value is not None:
                await _write_if_there(sdo, _parameter_object(pdo, sub, 16), value)
        await sdo.write_value(_mapping_object(pdo, 0, 8), 0)
        for number, each in enumerate(pdo.carries, start=1):
            doing = f"{pdo.title}, {each}"
            await sdo.write_value(_mapping_object(pdo, number, 32), each.mapping_entry)
        doing = pdo.title
        await sdo.write_value(_mapping_object(pdo, 0, 8), len(pdo.carries))
        await sdo.write_value(_parameter_object(pdo, 1, 32), cob)
    except SdoAborted as error:
        if error.abort == WRONG_STATE:
            raise MappingNotAllowed from None
        raise ControllerFault(
            "pdo-mapping",
            f"{name} refuses the mapping of {doing}: {abort_text(error.abort)}",
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
