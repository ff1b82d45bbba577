"""Connection to a drive: its identity, its PDO mapping, and the comparison of its settings with the fleet file."""

from dataclasses import replace
from fractions import Fraction

from adapters.cia402.canopen import objects as o
from adapters.cia402.canopen.bus import NMT_PRE_OPERATIONAL, NMT_START, OPERATIONAL
from adapters.cia402.canopen.node import BusDrive
from adapters.cia402.canopen.objects import DictionaryObject
from adapters.cia402.canopen.sdo import SdoAborted
from adapters.cia402.canopen.states import NEW_SET_POINT, QUICK_STOP, DriveState
from adapters.cia402.canopen.words import NOT_THERE, READ_ONLY, WRITE_ONLY
from adapters.cia402.eds import DriveProduct, read_product
from adapters.cia402.fleetaxes import POSITION_MAX, drive_units, only_axis, ramp_in_units
from adapters.cia402.mapping.transfer import MappingNotAllowed, PdoMapper
from adapters.cia402.options import Cia402Options
from adapters.cia402.shapes.trapezoid import WORD_MAX
from adapters.cia402.sync.starts import SyncScheduler
from adapters.contract import ControllerIdentity
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.link.can import CanFrame
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import Controller

_DRIVE_PROFILE = 402
_NMT = 0x000
_SLOW_DOWN, _QUICK_STOP_AND_STAY = 1, 6
_STOP_QUICKLY = 3  # of the abort connection option
_TRAPEZOID = 0
_BEATS = 5  # of its heartbeat periods, within which it must have reported operational
_STILL_NS = 60 * NS_PER_MS


async def identify_drive(node: BusDrive, boot_ms: int) -> ControllerIdentity:
    """Read the drive's identity. boot_ms: how long it may be silent after a power-up. Raises `ControllerFault`."""
    until_ns = node.clock.now_ns() + boot_ms * NS_PER_MS
    while True:
        try:
            device = await node.sdo.read_value(o.DEVICE_TYPE)
            break
        except ControllerFault as error:
            if error.code != "no-answer" or node.clock.now_ns() >= until_ns:
                raise
            node.log.info("no answer yet: the drive may still be booting")
    if device & 0xFFFF != _DRIVE_PROFILE:
        raise ControllerFault(
            "wrong-make",
            f"{node.name} has device type {device:08X}h, profile {device & 0xFFFF}; it is not a drive of CiA 402",
            "correct `link.address`",
        )
    serial = await _read_optional(node, o.SERIAL)
    return ControllerIdentity(
        model=await _read_optional_text(node, o.DEVICE_NAME) or "CiA 402 drive",
        firmware=await _read_optional_text(node, o.SOFTWARE),
        serial="" if not serial else f"{serial}",
    )


async def compare_product(node: BusDrive, wanted: DriveProduct) -> None:
    """Raise `ControllerFault` when the EDS file is that of another product; missing entries are not compared."""
    for obj, number in ((o.VENDOR, wanted.vendor), (o.PRODUCT, wanted.product)):
        held_number = await _read_optional(node, obj)
        if number is not None and held_number is not None and held_number != number:
            raise _mismatch_fault(
                node,
                f"{obj} is {held_number:#010x}, its EDS file is for {number:#010x}",
                "give the drive's own file in `options.eds`, or remove it",
            )


async def find_following_mode(node: BusDrive) -> int | None:
    """Return the preferred mode in which the drive follows positions; None: it has none."""
    modes = await _read_optional(node, o.SUPPORTED_MODES) or 0
    return next((mode for mode in o.FOLLOWED if modes >> mode - 1 & 1), None)


async def map_and_start(
    node: BusDrive, sync_scheduler: SyncScheduler, options: Cia402Options, mapper: PdoMapper
) -> bool:
    """Map its PDOs, set heartbeat and NMT state, and cancel commands that wait for a SYNC.

    A motion in progress continues. Return whether its PDOs differed from the required ones. Raises `ControllerFault`.
    """
    await node.sdo.write_value(o.HEARTBEAT, options.heartbeat_ms)
    try:
        node.layout, stranger = await mapper.map_all(node.sdo, node.number, node.name)
    except MappingNotAllowed:
        node.log.info("the drive accepts a mapping only in the pre-operational state")
        stranger = True
        await _map_pre_operational(node, mapper)
    await _start_node(node, options)
    if options.watchdog_ms is not None:
        await load_object(node, o.ABORT_CONNECTION_OPTION, _STOP_QUICKLY)
        await load_object(node, o.CONSUMER, options.host_node << 16 | options.watchdog_ms)
    node.handle_status(await node.sdo.read_value(o.STATUSWORD), node.clock.now_ns())
    node.control = await node.sdo.read_value(o.CONTROLWORD) & ~NEW_SET_POINT
    if node.state is DriveState.QUICK_STOP:
        node.log.info("the drive is in quick stop; it stays there until it is enabled")
        # It may have stopped by itself, and the controlword that enabled it would enable it again.
        node.control = QUICK_STOP
    node.mode = await node.sdo.read_value(o.MODE_DISPLAY)
    node.wanted_mode = await _read_wanted_mode(node)
    await _read_present_state(node)
    if node.has_outputs:
        node.outputs = await node.sdo.read_value(o.OUTPUTS)
    node.mapped = True
    if node.followed is not None:
        await load_object(node, o.PERIOD, options.period_ms)
        await load_object(node, o.PERIOD_INDEX, o.MILLISECONDS)
        # A position may wait for a SYNC, of a stream that is not continued.
        node.given = node.demand
        node.bus.send_frames(node.position_frame(node.given))
    if node.mode in o.FOLLOWED:
        node.send_control(node.control, o.PROFILE_POSITION_MODE)
    node.bus.send_frames(node.control_at_sync(node.control))
    node.loaded = not sync_scheduler.mark_connected(node.number)
    return stranger


async def _read_wanted_mode(node: BusDrive) -> int:
    """Return 6060h, which some drives do not let be read."""
    try:
        return await node.sdo.read_value(o.MODE)
    except SdoAborted as error:
        if error.abort != WRITE_ONLY:
            raise
        return node.mode


async def _read_present_state(node: BusDrive) -> None:
    """Read what PDOs report on change, or a little later."""
    is_reported = o.DEMAND in node.layout.reported
    demand = await node.sdo.read_value(o.DEMAND) if is_reported else None
    node.actual = await node.sdo.read_value(o.ACTUAL)
    node.demand = node.commanded.estimate(node.actual) if demand is None else demand
    if not is_reported:
        node.log.info(f"no PDO carries {o.DEMAND}: the commanded position is concluded from the actual one")
    if o.INPUTS in node.layout.reported:
        node.inputs = await node.sdo.read_value(o.INPUTS)
    else:
        node.log.info(f"no PDO carries {o.INPUTS}: limit switches and inputs are not shown")


async def _start_node(node: BusDrive, options: Cia402Options) -> None:
    """Bring it to the operational state, and wait until it reports that state.

    A boot-up may come late: on a bus full of SDOs it is the last to be sent. But it comes before the heartbeat.
    """
    began_ns = node.clock.now_ns()
    node.bus.send_frames(CanFrame(_NMT, bytes([NMT_START, node.number])))
    patience_ns = _BEATS * options.heartbeat_ms * NS_PER_MS + node.answer_ns
    if not await node.wait_until(lambda: node.beat_ns > began_ns and node.nmt == OPERATIONAL, began_ns + patience_ns):
        raise ControllerFault(
            "not-operational",
            f"{node.name} was commanded to start, and its heartbeat does not report operational (NMT "
            f"state {node.nmt:#04x})"
            if node.beat_ns > began_ns
            else f"{node.name} sends no heartbeat (1017h)",
            "is another master on the bus, or is the bus too busy for heartbeats? Try again",
        )


async def _map_pre_operational(node: BusDrive, mapper: PdoMapper) -> None:
    """Map PDOs in the pre-operational state, for drives that accept a mapping only there; it would stop a moving
    drive."""
    old_position = await node.sdo.read_value(o.ACTUAL)
    if await node.wait_until(
        lambda: False, node.clock.now_ns() + _STILL_NS
    ) or old_position != await node.sdo.read_value(o.ACTUAL):
        raise ControllerFault(
            "moving", f"{node.name} moves, and accepts no PDO mapping meanwhile", "wait until it is at rest"
        )
    node.bus.send_frames(CanFrame(_NMT, bytes([NMT_PRE_OPERATIONAL, node.number])))
    try:
        node.layout, _ = await mapper.map_all(node.sdo, node.number, node.name)
    except MappingNotAllowed:
        raise ControllerFault(
            "pdo-mapping", f"{node.name} accepts no PDO mapping, not even pre-operational", "see the drive's manual"
        ) from None


async def compare_settings(node: BusDrive, config: Controller, options: Cia402Options) -> None:
    """Compare the drive's settings with the fleet file; load those that the adapter requires. Raises
    `ControllerFault`."""
    _, axis = only_axis(config)
    for name, pair, wanted_ratio in (
        ("encoder", o.ENCODER, options.encoder),
        ("gear", o.GEAR, options.gear),
        ("feed", o.FEED, options.feed),
    ):
        if wanted_ratio is not None:
            await _compare_ratio(node, name, pair, wanted_ratio)
    polarity = await _read_optional(node, o.POLARITY)
    if polarity:
        raise _mismatch_fault(
            node, f"{o.POLARITY} is {polarity:#04x}, wanted 0", "set it to 0, and use `sign` in the fleet file"
        )
    own = drive_units(options)
    quickest = options.quick_stop_acceleration
    # Optional objects (CiA 402-2); a drive without them does what their defaults state: 1, 2 and 0.
    await load_optional(node, o.HALT_OPTION, _SLOW_DOWN)
    node.quick_stop_disables = not await load_optional(node, o.QUICK_STOP_OPTION, _QUICK_STOP_AND_STAY)
    if node.quick_stop_disables:
        node.log.info(f"the drive has no {o.QUICK_STOP_OPTION}: a quick stop switches it off; it is enabled again")
    await load_optional(node, o.PROFILE_TYPE, _TRAPEZOID)
    ramp = ramp_in_units(axis, own)
    await load_object(node, o.ACCELERATION, ramp)
    await _load_deceleration(node, ramp)
    if quickest is not None:
        wanted_units = round(quickest * float(axis.scale) * own.acceleration)
        await load_object(node, o.QUICK_STOP_DECELERATION, max(1, min(WORD_MAX, wanted_units)))


async def _load_deceleration(node: BusDrive, ramp: int) -> None:
    """Load 6084h, or record that the drive has none."""
    if o.DECELERATION not in node.layout.absent:
        try:
            await node.sdo.write_value(o.DECELERATION, ramp)
        except SdoAborted as error:
            if error.abort not in NOT_THERE:
                raise _refused_fault(node, o.DECELERATION, ramp, error) from None
        else:
            await _require_held(node, o.DECELERATION, ramp)
            return
    node.layout = replace(node.layout, absent=node.layout.absent | {o.DECELERATION})
    node.log.info(f"the drive has no {o.DECELERATION}: both ramps of a move are equal, by {o.ACCELERATION}")


async def load_object(node: BusDrive, obj: DictionaryObject, value: int) -> None:
    """Write an object and read it back; one that cannot be written must hold the value. Raises `ControllerFault`
    (config-mismatch)."""
    try:
        await node.sdo.write_value(obj, value)
    except SdoAborted as error:
        if error.abort == READ_ONLY and await node.sdo.read_value(obj) == value:
            return
        raise _refused_fault(node, obj, value, error) from None
    await _require_held(node, obj, value)


def _refused_fault(node: BusDrive, obj: DictionaryObject, value: int, error: SdoAborted) -> ControllerFault:
    return _mismatch_fault(node, f"{obj} does not accept {value}: {error}", "check the drive's manual")


async def _require_held(node: BusDrive, obj: DictionaryObject, value: int) -> None:
    held_value = await node.sdo.read_value(obj)
    if held_value != value:
        raise _mismatch_fault(node, f"{obj} is {held_value}, wanted {value}", "is another master on the bus?")


async def load_optional(node: BusDrive, obj: DictionaryObject, value: int) -> bool:
    """Like `load_object`; return False for a drive without the object."""
    if await _read_optional(node, obj) is None:
        return False
    await load_object(node, obj, value)
    return True


async def wait_for_rest(node: BusDrive, timeout_s: float) -> None:
    """Wait until a motion in progress is over. Raises `ControllerFault`."""

    def is_still() -> bool:
        return node.clock.now_ns() - node.moved_ns > _STILL_NS

    until_ns = node.clock.now_ns() + round(timeout_s * NS_PER_S)
    while not is_still():
        if node.clock.now_ns() > until_ns:
            raise ControllerFault("moving", f"{node.name} moves and does not come to rest", "stop it at the drive")
        await node.wait_until(is_still, node.clock.now_ns() + _STILL_NS)


async def _compare_ratio(
    node: BusDrive, name: str, pair: tuple[DictionaryObject, DictionaryObject], wanted: Fraction
) -> None:
    try:
        over, under = await node.sdo.read_value(pair[0]), await node.sdo.read_value(pair[1])
    except SdoAborted as error:
        raise _mismatch_fault(node, f"option `{name}` cannot be compared: {error}", f"leave `{name}` out") from None
    if under == 0 or Fraction(over, under) != wanted:
        raise _mismatch_fault(
            node,
            f"{pair[0]} is {over} per {under}, wanted {wanted} (option `{name}`)",
            f"correct the drive's factor group, or `{name}` and `scale` in the fleet file",
        )


async def _read_optional(node: BusDrive, obj: DictionaryObject) -> int | None:
    try:
        return await node.sdo.read_value(obj)
    except SdoAborted as error:
        if error.abort not in NOT_THERE:
            raise
        return None


async def _read_optional_text(node: BusDrive, obj: DictionaryObject) -> str:
    try:
        return await node.sdo.read_text(obj)
    except SdoAborted as error:
        if error.abort not in NOT_THERE:
            raise
        return ""


def _mismatch_fault(node: BusDrive, text: str, remedy: str) -> ControllerFault:
    return ControllerFault("config-mismatch", f"{node.name}: {text}", remedy)


async def load_soft_limits(node: BusDrive, pair: tuple[int, int] | None) -> None:
    """Load 607Dh; the whole range for an axis whose position is unknown."""
    low, high = (-POSITION_MAX, POSITION_MAX) if pair is None else pair
    for obj, value in ((o.LIMIT_LOW, low), (o.LIMIT_HIGH, high)):
        node.held[obj] = value
        if not await load_optional(node, obj, value):
            del node.held[obj]
            node.log.info(f"the drive has no {obj}: the limits of the axis are kept by plans and jogs alone")


def require_product(path: str, config: Controller, options: Cia402Options) -> DriveProduct:
    """Return the product in the EDS of that path. Raises `ControllerFault`."""
    try:
        return read_product(path, config, options)
    except ValueError as error:
        raise ControllerFault("config-mismatch", str(error), "correct `options.eds`, or remove it") from None
