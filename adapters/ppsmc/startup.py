"""Meeting a unit in any state, and comparing what it holds with the fleet file."""

from fractions import Fraction

from adapters.contract import DriverFault, Identity
from adapters.ppsmc import fleetaxes
from adapters.ppsmc.options import Options
from adapters.ppsmc.replies import ASK_SETTINGS, ASK_VERSION, settings
from adapters.ppsmc.unitstate import Look, UnitState
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns

MODEL = "pp-electronic SMC"
_BUSY_LOOK_NS = 100 * NS_PER_MS


async def identify(unit: UnitState) -> Identity:
    """Ask who it is; a blocked unit has only its greeting. Raises `DriverFault`."""
    session = unit.session
    try:
        version = (await session.ask(ASK_VERSION)).text(ASK_VERSION)
    except DriverFault as error:
        if error.fault.code == "garbage":
            raise DriverFault(
                "wrong-make", f"{session.link.place} is no SMC: {error}", "correct `adapter` or `link`"
            ) from None
        if error.fault.code != "blocked":
            raise
        version = session.greeting or "smc"
    return Identity(model=MODEL, firmware=version.lower().partition("smc")[2].strip(), serial="")


async def wait_idle(unit: UnitState, clock: Clock, options: Options) -> Look:
    """Wait until nothing moves and no program runs; what a person has begun is not stopped. Raises `DriverFault`."""
    until_ns = clock.now_ns() + round(options.busy_wait_s * NS_PER_S)
    while not (look := await unit.look()).idle:
        if look.blocked:
            return look
        if clock.now_ns() > until_ns:
            doing = "a program runs" if look.program else "an axis moves"
            raise DriverFault(
                "busy",
                f"{doing} on {unit.session.link.place} since {options.busy_wait_s:g} s; nobody has begun that here",
                "wait for its end, or stop it (`q` at the unit, or `tutti stop`)",
            )
        await sleep_ns(clock, _BUSY_LOOK_NS)
    return look


async def introduce(unit: UnitState, options: Options) -> None:
    """Compare an idle unit with the fleet file, and load what the adapter needs of it. Raises `DriverFault`."""
    session, config = unit.session, unit.config
    commands = ["pqrf0", "tbc"]
    if options.panel == "lock":
        commands.append("remote")
    found = settings((await session.settle(commands, ASK_SETTINGS)).lines(ASK_SETTINGS))
    wishes: dict[str, str] = {}
    for name, axis in config.axes.items():
        motor = fleetaxes.motor(axis)
        held = found.get(motor)
        if held is None:
            known = ", ".join(map(str, sorted(found))) or "none"
            raise _mismatch(f"axes.{name}.motors", known, str(motor), "name an axis that the unit has")
        gear = unit.gears[motor] = _gear(held, motor)
        wanted = fleetaxes.expected_gear(axis) if options.check_gear else None
        if wanted is not None and gear != wanted:
            raise _mismatch(
                f"gear of axis {name} (gnum{motor}/gden{motor})",
                f"{gear} steps per mm or deg",
                f"{wanted} by scale and unit",
                "correct `scale`, or the unit's gear, or set option check_gear to false",
            )
        unit.homes[motor] = round(_fraction(held, "rofs", motor, "0") * gear)
        if int(_fraction(held, "dcpl", motor, "4")) < (places := fleetaxes.decimals(gear)):
            wishes[f"dcpl{motor}"] = str(places)
        loop = options.loop.get(name)
        if loop is not None and held.get("ecl", "0") != (ecl := str(int(loop == "closed"))):
            wishes[f"ecl{motor}"] = ecl
        elif held.get("ecl", "0") == "1":
            unit.closed.add(motor)
        if loop == "open":
            unit.closed.discard(motor)
        elif loop == "closed":
            unit.closed.add(motor)
    if wishes:
        heard = await session.settle([f"{name}:{value}" for name, value in wishes.items()], ASK_SETTINGS)
        now = {f"{n}{axis}": v for axis, each in settings(heard.lines(ASK_SETTINGS)).items() for n, v in each.items()}
        for name, value in wishes.items():
            if now.get(name) != value:
                raise _mismatch(name, now.get(name, "nothing"), value, "set it at the unit and save it with `update`")
    unit.introduced = True


def _gear(held: dict[str, str], motor: int) -> Fraction:
    gear = _fraction(held, "gnum", motor) / (_fraction(held, "gden", motor) or 1)
    if gear <= 0:
        raise _mismatch(f"gnum{motor}/gden{motor}", str(gear), "a gear above 0", "correct it at the unit")
    return gear


def _fraction(held: dict[str, str], name: str, motor: int, default: str = "") -> Fraction:
    text = held.get(name, default)
    try:
        return Fraction(text)
    except (ValueError, ZeroDivisionError):
        raise _mismatch(f"{name}{motor}", text or "nothing", "a number", "look at what `?conf` answers") from None


def _mismatch(item: str, found: str, wanted: str, remedy: str) -> DriverFault:
    return DriverFault("config-mismatch", f"{item}: the unit has {found}, wanted is {wanted}", remedy)
