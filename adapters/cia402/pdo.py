"""The PDOs that the adapter has a drive use: its state comes unasked, and orders take one frame.

RPDO 1 is taken with the next SYNC and carries what starts; RPDO 2 is taken at once and carries everything else that the
state machine is told; RPDO 3 and 4 carry a set-point. TPDO 1 is sent on change, the others at most so often. Of a drive
that follows positions, RPDO 4 carries those, taken with each SYNC, and TPDO 4 answers each SYNC.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from adapters.cia402 import objects as o
from adapters.cia402.bus import RPDO, TPDO
from adapters.cia402.objects import Obj
from adapters.cia402.options import Options
from adapters.cia402.sdo import SdoAborted, SdoClient
from adapters.cia402.words import NOT_THERE, WRONG_STATE, abort_text
from adapters.contract import DriverFault

_OFF = 1 << 31
_COB_MASK = 0x7FF
SYNCHRONOUS, AT_ONCE = 1, 255


class NotNow(Exception):
    """The drive takes no mapping in its present NMT state."""


@dataclass(frozen=True, slots=True)
class Pdo:
    """One PDO: number from 1, function code, transmission type, what it carries. inhibit, timer: None where there are
    none, in 0.1 ms and ms."""

    title: str
    parameter: int
    mapping: int
    function: int
    kind: int
    carries: tuple[Obj, ...]
    inhibit: int | None = None
    timer: int | None = None


def pdos(options: Options, *, outputs: bool, followed: Obj | None = None) -> tuple[Pdo, ...]:
    """All PDOs of a drive. outputs: some are named, and are switched with the controlword. followed: the object of the
    positions that are streamed to it; None: none are."""
    switched = (o.OUTPUTS,) if outputs else ()
    slow = options.inhibit_ms * 10
    fourth = (
        (Pdo("RPDO 4", 0x1403, 0x1603, RPDO[3], AT_ONCE, (o.ACCELERATION, o.DECELERATION)),)
        if followed is None
        else (
            Pdo("RPDO 4", 0x1403, 0x1603, RPDO[3], SYNCHRONOUS, (followed,)),
            Pdo("TPDO 4", 0x1803, 0x1A03, TPDO[3], SYNCHRONOUS, (o.STATUSWORD, o.DEMAND)),
        )
    )
    return (
        Pdo("RPDO 1", 0x1400, 0x1600, RPDO[0], SYNCHRONOUS, (o.CONTROLWORD, *switched)),
        Pdo("RPDO 2", 0x1401, 0x1601, RPDO[1], AT_ONCE, (o.CONTROLWORD, o.MODE, *switched)),
        Pdo("RPDO 3", 0x1402, 0x1602, RPDO[2], AT_ONCE, (o.TARGET, o.PROFILE_VELOCITY)),
        Pdo("TPDO 1", 0x1800, 0x1A00, TPDO[0], AT_ONCE, (o.STATUSWORD, o.MODE_DISPLAY), 0, options.state_ms),
        Pdo("TPDO 2", 0x1801, 0x1A01, TPDO[1], AT_ONCE, (o.DEMAND, o.ACTUAL), slow, options.state_ms),
        Pdo("TPDO 3", 0x1802, 0x1A02, TPDO[2], AT_ONCE, (o.INPUTS, o.VELOCITY), slow, options.state_ms),
        *fourth,
    )


async def map_all(sdo: SdoClient, node: int, name: str, wanted: Sequence[Pdo]) -> bool:
    """Map them where they are not yet as wanted, and read them back; whether any was not. Raises `NotNow`,
    `DriverFault`."""
    changed = False
    for pdo in wanted:
        if await _found(sdo, node, pdo):
            continue
        changed = True
        await _map(sdo, node, name, pdo)
        if not await _found(sdo, node, pdo):
            carried = ", ".join(str(each) for each in pdo.carries)
            raise DriverFault(
                "pdo-mapping",
                f"{name} has taken a mapping for {pdo.title} and does not hold it: wanted {carried}",
                "is another master on the bus? Is the mapping fixed? See the drive's manual",
            )
    return changed


async def _found(sdo: SdoClient, node: int, pdo: Pdo) -> bool:
    parameter, count = _parameter(pdo, 1, 32), _mapped(pdo, 0, 8)
    try:
        cob = await sdo.read(parameter)
        if cob & (_OFF | _COB_MASK) != pdo.function + node or await sdo.read(_parameter(pdo, 2, 8)) != pdo.kind:
            return False
        if await sdo.read(count) != len(pdo.carries):
            return False
        for number, each in enumerate(pdo.carries, start=1):
            if await sdo.read(_mapped(pdo, number, 32)) != each.mapping:
                return False
    except SdoAborted as error:
        if error.abort not in NOT_THERE:
            raise
        return False
    return await _timed(sdo, pdo)


async def _timed(sdo: SdoClient, pdo: Pdo) -> bool:
    """Its times, which a drive need not have."""
    for sub, value in ((3, pdo.inhibit), (5, pdo.timer)):
        if value is not None:
            try:
                if await sdo.read(_parameter(pdo, sub, 16)) != value:
                    return False
            except SdoAborted as error:
                if error.abort not in NOT_THERE:
                    raise
    return True


async def _map(sdo: SdoClient, node: int, name: str, pdo: Pdo) -> None:
    """By the order that CiA 301 prescribes: switched off, emptied, filled, counted, switched on."""
    cob = pdo.function + node
    doing = pdo.title
    try:
        await sdo.write(_parameter(pdo, 1, 32), cob | _OFF)
        await sdo.write(_parameter(pdo, 2, 8), pdo.kind)
        for sub, value in ((3, pdo.inhibit), (5, pdo.timer)):
            if value is not None:
                await _write_if_there(sdo, _parameter(pdo, sub, 16), value)
        await sdo.write(_mapped(pdo, 0, 8), 0)
        for number, each in enumerate(pdo.carries, start=1):
            doing = f"{pdo.title}, {each}"
            await sdo.write(_mapped(pdo, number, 32), each.mapping)
        doing = pdo.title
        await sdo.write(_mapped(pdo, 0, 8), len(pdo.carries))
        await sdo.write(_parameter(pdo, 1, 32), cob)
    except SdoAborted as error:
        if error.abort == WRONG_STATE:
            raise NotNow from None
        raise DriverFault(
            "pdo-mapping",
            f"{name} refuses the mapping of {doing}: {abort_text(error.abort)}",
            "does the drive allow this object in a PDO, and mapping at all? Compare its EDS file and its manual",
        ) from None


async def _write_if_there(sdo: SdoClient, obj: Obj, value: int) -> None:
    try:
        await sdo.write(obj, value)
    except SdoAborted as error:
        if error.abort not in NOT_THERE:
            raise


def _parameter(pdo: Pdo, sub: int, bits: int) -> Obj:
    names = {1: "COB-ID", 2: "transmission type", 3: "inhibit time", 5: "event timer"}
    return Obj(pdo.parameter, sub, bits, f"{names[sub]} of {pdo.title}")


def _mapped(pdo: Pdo, sub: int, bits: int) -> Obj:
    return Obj(pdo.mapping, sub, bits, f"mapping of {pdo.title}")
