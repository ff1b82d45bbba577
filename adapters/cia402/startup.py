"""Meeting a drive: who it is, its PDOs as the adapter wants them, and whether it counts as the fleet file says."""

from fractions import Fraction

from adapters.cia402 import objects as o
from adapters.cia402 import pdo
from adapters.cia402.bus import NMT_PRE_OPERATIONAL, NMT_START, OPERATIONAL
from adapters.cia402.eds import Product
from adapters.cia402.fleetaxes import only_axis, ramp, units
from adapters.cia402.node import Node
from adapters.cia402.objects import Obj
from adapters.cia402.options import Options
from adapters.cia402.sdo import SdoAborted
from adapters.cia402.shape import WORD_MAX
from adapters.cia402.starts import Starts
from adapters.cia402.states import NEW_SET_POINT, QUICK_STOP, State
from adapters.cia402.words import NOT_THERE
from adapters.contract import DriverFault, Identity
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.link.can import CanFrame
from orchestrator.model.fleet import Controller

_DRIVE_PROFILE = 402
_NMT = 0x000
_SLOW_DOWN, _QUICK_STOP_AND_STAY = 1, 6
_STOP_QUICKLY = 3  # of the abort connection option
_TRAPEZOID = 0
_MILLISECONDS = -3
_BEATS = 5  # of its heartbeats, until it must have said that it is operational
_STILL_NS = 60 * NS_PER_MS


async def identify(node: Node, boot_ms: int) -> Identity:
    """boot_ms: how long it may be silent, because it has just been switched on. Raises `DriverFault`."""
    until_ns = node.clock.now_ns() + boot_ms * NS_PER_MS
    while True:
        try:
            device = await node.sdo.read(o.DEVICE_TYPE)
            break
        except DriverFault as error:
            if error.fault.code != "no-answer" or node.clock.now_ns() >= until_ns:
                raise
    if device & 0xFFFF != _DRIVE_PROFILE:
        raise DriverFault(
            "wrong-make",
            f"{node.name} has device type {device:08X}h, profile {device & 0xFFFF}; it is no drive of CiA 402",
            "correct `link.unit`",
        )
    serial = await _if_there(node, o.SERIAL)
    return Identity(
        model=await _text(node, o.DEVICE_NAME) or "CiA 402 drive",
        firmware=await _text(node, o.SOFTWARE),
        serial="" if not serial else f"{serial}",
    )


async def compare_product(node: Node, wanted: Product) -> None:
    """Raises `DriverFault` when the EDS file is that of another product; what it does not say is not compared."""
    for obj, number in ((o.VENDOR, wanted.vendor), (o.PRODUCT, wanted.product)):
        found = await _if_there(node, obj)
        if number is not None and found is not None and found != number:
            raise _mismatch(
                node,
                f"{obj} is {found:#010x}, its EDS file is for {number:#010x}",
                "give the drive's own file in `options.eds`, or leave it out",
            )


async def way_to_follow(node: Node) -> int | None:
    """The mode in which the drive follows positions, the best that it has; None: it has none."""
    modes = await _if_there(node, o.SUPPORTED_MODES) or 0
    return next((mode for mode in o.FOLLOWED if modes >> mode - 1 & 1), None)


async def take_over(node: Node, starts: Starts, options: Options, wanted: tuple[pdo.Pdo, ...]) -> bool:
    """Map its PDOs, have it live and speak, and take away what somebody may have left waiting for a SYNC.

    Its motion, if it has one, goes on. Whether it was a stranger: its PDOs were not as wanted. Raises `DriverFault`.
    """
    await node.sdo.write(o.HEARTBEAT, options.heartbeat_ms)
    try:
        stranger = await pdo.map_all(node.sdo, node.number, node.name, wanted)
    except pdo.NotNow:
        stranger = True
        await _map_pre_operational(node, wanted)
    await _start(node, options)
    if options.watchdog_ms is not None:
        await load(node, o.ABORT_CONNECTION_OPTION, _STOP_QUICKLY)
        await load(node, o.CONSUMER, options.host_node << 16 | options.watchdog_ms)
    node.take_status(await node.sdo.read(o.STATUSWORD), node.clock.now_ns())
    node.control = await node.sdo.read(o.CONTROLWORD) & ~NEW_SET_POINT
    if node.state is State.QUICK_STOP:
        # It may have stopped by itself, and the word that enabled it would enable it again.
        node.control = QUICK_STOP
    node.mode, node.wanted_mode = await node.sdo.read(o.MODE_DISPLAY), await node.sdo.read(o.MODE)
    # What comes by PDO comes on change, or a little later; this is from now on.
    node.demand, node.actual = await node.sdo.read(o.DEMAND), await node.sdo.read(o.ACTUAL)
    node.inputs = await node.sdo.read(o.INPUTS)
    if node.has_outputs:
        node.outputs = await node.sdo.read(o.OUTPUTS)
    node.mapped = True
    if node.followed is not None:
        await load(node, o.PERIOD, options.period_ms)
        await load(node, o.PERIOD_INDEX, _MILLISECONDS)
        # A position may wait for a SYNC, of a stream that nobody leads any more.
        node.bus.send(node.position(node.demand))
    if node.mode in o.FOLLOWED:
        node.order(node.control, o.PROFILE_POSITION_MODE)
    node.bus.send(node.at_sync(node.control))
    node.loaded = not starts.met(node.number)
    return stranger


async def _start(node: Node, options: Options) -> None:
    """Have it operational, by its own word.

    A boot-up may come late: on a bus full of SDOs it is the last to be sent. But it comes before the heartbeat.
    """
    began_ns = node.clock.now_ns()
    node.bus.send(CanFrame(_NMT, bytes([NMT_START, node.number])))
    patience_ns = _BEATS * options.heartbeat_ms * NS_PER_MS + node.answer_ns
    if not await node.until(lambda: node.beat_ns > began_ns and node.nmt == OPERATIONAL, began_ns + patience_ns):
        raise DriverFault(
            "not-operational",
            f"{node.name} was told to start, and its heartbeat does not say that it is operational (NMT state "
            f"{node.nmt:#04x})"
            if node.beat_ns > began_ns
            else f"{node.name} sends no heartbeat (1017h)",
            "is another master on the bus, or is the bus too busy for heartbeats? Try again",
        )


async def _map_pre_operational(node: Node, wanted: tuple[pdo.Pdo, ...]) -> None:
    """For drives that take a mapping in that NMT state only; it would stop one that moves."""
    before = await node.sdo.read(o.ACTUAL)
    if await node.until(lambda: False, node.clock.now_ns() + _STILL_NS) or before != await node.sdo.read(o.ACTUAL):
        raise DriverFault(
            "moving", f"{node.name} moves, and takes no PDO mapping meanwhile", "wait until it is at rest"
        )
    node.bus.send(CanFrame(_NMT, bytes([NMT_PRE_OPERATIONAL, node.number])))
    try:
        await pdo.map_all(node.sdo, node.number, node.name, wanted)
    except pdo.NotNow:
        raise DriverFault(
            "pdo-mapping", f"{node.name} takes no PDO mapping, not even pre-operational", "see the drive's manual"
        ) from None


async def compare(node: Node, config: Controller, options: Options) -> None:
    """What the drive holds against the fleet file; loads what the adapter relies on. Raises `DriverFault`."""
    _, axis = only_axis(config)
    for name, pair, wanted in (
        ("encoder", o.ENCODER, options.encoder),
        ("gear", o.GEAR, options.gear),
        ("feed", o.FEED, options.feed),
    ):
        if wanted is not None:
            await _compare_ratio(node, name, pair, wanted)
    polarity = await _if_there(node, o.POLARITY)
    if polarity:
        raise _mismatch(
            node, f"{o.POLARITY} is {polarity:#04x}, wanted 0", "set it to 0, and use `sign` in the fleet file"
        )
    own = units(options)
    quickest = options.quick_stop_acceleration
    loads: list[tuple[Obj, int]] = [
        (o.HALT_OPTION, _SLOW_DOWN),
        (o.QUICK_STOP_OPTION, _QUICK_STOP_AND_STAY),
        (o.PROFILE_TYPE, _TRAPEZOID),
        (o.ACCELERATION, ramp(axis, own)),
        (o.DECELERATION, ramp(axis, own)),
    ]
    if quickest is not None:
        wanted_units = round(quickest * float(axis.scale) * own.acceleration)
        loads.append((o.QUICK_STOP_DECELERATION, max(1, min(WORD_MAX, wanted_units))))
    for obj, value in loads:
        await load(node, obj, value)


async def load(node: Node, obj: Obj, value: int) -> None:
    """Write and read back. Raises `DriverFault` (config-mismatch)."""
    try:
        await node.sdo.write(obj, value)
    except SdoAborted as error:
        raise _mismatch(node, f"{obj} does not take {value}: {error}", "compare the drive's manual") from None
    found = await node.sdo.read(obj)
    if found != value:
        raise _mismatch(node, f"{obj} is {found}, wanted {value}", "is another master on the bus?")


async def rest(node: Node, patience_s: float) -> None:
    """Wait until a motion that was found is over. Raises `DriverFault`."""

    def still() -> bool:
        return node.clock.now_ns() - node.moved_ns > _STILL_NS

    until_ns = node.clock.now_ns() + round(patience_s * NS_PER_S)
    while not still():
        if node.clock.now_ns() > until_ns:
            raise DriverFault("moving", f"{node.name} moves and does not come to rest", "stop it at the drive")
        await node.until(still, node.clock.now_ns() + _STILL_NS)


async def _compare_ratio(node: Node, name: str, pair: tuple[Obj, Obj], wanted: Fraction) -> None:
    try:
        over, under = await node.sdo.read(pair[0]), await node.sdo.read(pair[1])
    except SdoAborted as error:
        raise _mismatch(node, f"option `{name}` can not be compared: {error}", f"leave `{name}` out") from None
    if under == 0 or Fraction(over, under) != wanted:
        raise _mismatch(
            node,
            f"{pair[0]} is {over} per {under}, wanted {wanted} (option `{name}`)",
            f"correct the drive's factor group, or `{name}` and `scale` in the fleet file",
        )


async def _if_there(node: Node, obj: Obj) -> int | None:
    try:
        return await node.sdo.read(obj)
    except SdoAborted as error:
        if error.abort not in NOT_THERE:
            raise
        return None


async def _text(node: Node, obj: Obj) -> str:
    try:
        return await node.sdo.read_text(obj)
    except SdoAborted as error:
        if error.abort not in NOT_THERE:
            raise
        return ""


def _mismatch(node: Node, text: str, remedy: str) -> DriverFault:
    return DriverFault("config-mismatch", f"{node.name}: {text}", remedy)
