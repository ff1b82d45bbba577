"""Connection to a controller in any state, and comparison of its settings with the fleet file."""

from fractions import Fraction

from adapters.contract import ControllerIdentity
from adapters.ppsmc import fleetaxes
from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.replies import ASK_SETTINGS, ASK_VERSION, parse_setting, parse_settings
from adapters.ppsmc.session import PpSmcSession
from adapters.ppsmc.unitstate import PpSmcReading, PpSmcState
from adapters.ppsmc.watch import watched_settings
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.model.errors import ControllerFault

MODEL = "pp-electronic SMC"
_BUSY_POLL_NS = 100 * NS_PER_MS


async def identify_controller(unit: PpSmcState) -> ControllerIdentity:
    """Query the identity; a blocked controller has only its greeting. Raises `ControllerFault`."""
    session = unit.session
    try:
        version = (await session.send_queries(ASK_VERSION)).first_text(ASK_VERSION)
    except ControllerFault as error:
        if error.code == "garbage":
            raise ControllerFault(
                "wrong-make", f"{session.link.endpoint} is not an SMC: {error}", "correct `adapter` or `link`"
            ) from None
        if error.code != "blocked":
            raise
        version = session.greeting or "smc"
    return ControllerIdentity(model=MODEL, firmware=version.lower().partition("smc")[2].strip(), serial="")


async def wait_idle(unit: PpSmcState, clock: Clock, options: PpSmcOptions) -> PpSmcReading:
    """Wait until nothing moves and no program runs; motions begun elsewhere are not stopped. Raises
    `ControllerFault`."""
    until_ns = clock.now_ns() + round(options.busy_wait_s * NS_PER_S)
    is_waiting = False
    while not (look := await unit.read_state()).is_idle:
        if look.is_blocked:
            unit.session.log.warning("the controller is blocked")
            return look
        if not is_waiting:
            unit.session.log.info("waiting for the end of a motion or program of another client")
            is_waiting = True
        if clock.now_ns() > until_ns:
            activity = "a program runs" if look.program_runs else "an axis moves"
            raise ControllerFault(
                "busy",
                f"{activity} on {unit.session.link.endpoint} for {options.busy_wait_s:g} s; it was not begun by this "
                "adapter",
                "wait for its end, or stop it (`q` at the controller, or `tutti stop`)",
            )
        await sleep_ns(clock, _BUSY_POLL_NS)
    return look


async def compare_and_load(unit: PpSmcState, options: PpSmcOptions) -> None:
    """Compare an idle controller with the fleet file, and load the settings that the adapter needs. Raises
    `ControllerFault`."""
    session, config = unit.session, unit.config
    commands = ["pqrf0", "tbc"]
    if options.panel == "lock":
        commands.append("remote")
    settings = parse_settings((await session.send_repeatable(commands, ASK_SETTINGS)).reply_texts(ASK_SETTINGS))
    wishes: dict[str, str] = {}
    for name, axis in config.axes.items():
        motor = fleetaxes.axis_number(axis)
        motor_settings = settings.get(motor)
        if motor_settings is None:
            motors_text = ", ".join(map(str, sorted(settings))) or "none"
            raise _mismatch_fault(
                f"axes.{name}.motors", motors_text, str(motor), "name an axis that the controller has"
            )
        gear = unit.gears[motor] = _read_gear(motor_settings, motor)
        wanted_gear = fleetaxes.expected_gear(axis) if options.check_gear else None
        if wanted_gear is not None and gear != wanted_gear:
            raise _mismatch_fault(
                f"gear of axis {name} (gnum{motor}/gden{motor})",
                f"{gear} steps per mm or deg",
                f"{wanted_gear} by scale and unit",
                "correct `scale`, or the controller's gear, or set option check_gear to false",
            )
        unit.homes[motor] = round(_read_fraction(motor_settings, "rofs", motor, "0") * gear)
        if int(_read_fraction(motor_settings, "dcpl", motor, "4")) < (places := fleetaxes.gear_decimals(gear)):
            wishes[f"dcpl{motor}"] = str(places)
        wishes |= _loop_wishes(unit, motor, motor_settings, options.loop.get(name))
        unit.settings[motor] = watched_settings(motor_settings)
    if wishes:
        await _load_settings(session, wishes)
        for motor, expected_settings in unit.settings.items():
            expected_settings.update(
                {name: wishes[f"{name}{motor}"] for name in expected_settings if f"{name}{motor}" in wishes}
            )
    unit.introduced = True


def _loop_wishes(unit: PpSmcState, motor: int, held: dict[str, str], loop: str | None) -> dict[str, str]:
    """Return the setting of the control loop to load, if any; record whether the loop is closed."""
    wishes: dict[str, str] = {}
    if loop is not None and held.get("ecl", "0") != (ecl := str(int(loop == "closed"))):
        wishes[f"ecl{motor}"] = ecl
    elif held.get("ecl", "0") == "1":
        unit.closed.add(motor)
    if loop == "open":
        unit.closed.discard(motor)
    elif loop == "closed":
        unit.closed.add(motor)
    return wishes


async def _load_settings(session: PpSmcSession, wishes: dict[str, str]) -> None:
    """Load settings and read them back. Raises `ControllerFault`."""
    session.log.info("loading settings of the fleet file", settings=wishes)
    reply = await session.send_repeatable([f"{name}:{value}" for name, value in wishes.items()], ASK_SETTINGS)
    held_settings = {
        f"{n}{axis}": v
        for axis, axis_settings in parse_settings(reply.reply_texts(ASK_SETTINGS)).items()
        for n, v in axis_settings.items()
    }
    for name, value in wishes.items():
        if held_settings.get(name) != value:
            raise _mismatch_fault(
                name, held_settings.get(name, "nothing"), value, "set it at the controller and save it with `update`"
            )


def _read_gear(held: dict[str, str], motor: int) -> Fraction:
    gear = _read_fraction(held, "gnum", motor) / (_read_fraction(held, "gden", motor) or 1)
    if gear <= 0:
        raise _mismatch_fault(f"gnum{motor}/gden{motor}", str(gear), "a gear above 0", "correct it at the controller")
    return gear


def _read_fraction(held: dict[str, str], name: str, motor: int, default: str = "") -> Fraction:
    text = held.get(name, default)
    value = parse_setting(text)
    if value is None:
        raise _mismatch_fault(f"{name}{motor}", text[:40] or "nothing", "a number", "check the reply to `?conf`")
    return value


def _mismatch_fault(item: str, found: str, wanted: str, remedy: str) -> ControllerFault:
    return ControllerFault("config-mismatch", f"{item}: the controller has {found}, required is {wanted}", remedy)
