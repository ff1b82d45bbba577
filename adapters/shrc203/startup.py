"""Meeting a unit in any state, and comparing what it holds with the fleet file."""

from adapters.contract import DriverFault, Identity
from adapters.shrc203 import fleetaxes
from adapters.shrc203.axes import CONTROLLABLE
from adapters.shrc203.buffers import Buffers
from adapters.shrc203.options import Options
from adapters.shrc203.replies import (
    CONTROLLABLE as CONTROLLABLE_FORM,
)
from adapters.shrc203.replies import (
    FORMAT,
    IDENTITY,
    MODE,
    READY,
    SETTLING,
    STATUS,
    flags,
    sizes,
    status,
    triple,
    triples,
)
from adapters.shrc203.session import Session
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.model.fleet import Controller

_BUSY_LOOK_NS = 100 * NS_PER_MS


async def identify(session: Session) -> Identity:
    """Take the unit to HOST mode and SHOT/FC format and ask who it is. Raises `DriverFault`."""
    identity = (await session.ask("*IDN?", IDENTITY)).split(",")
    _, model, serial, firmware = identity
    if model != "SHRC-203":
        raise DriverFault(
            "wrong-make",
            f"{session.link.place} is {','.join(identity)}, not an SHRC-203",
            "correct `adapter` or `link` in the fleet file",
        )
    mode = await session.ask("?:MODE", MODE)
    if mode != "HOST":
        await _to_host(session, mode)
    if await session.ask("?:FMT", FORMAT) != "SHOT_FC" and not await session.try_to_tell("FMT:SHOT_FC"):
        raise DriverFault("wrong-format", "the unit keeps to HIT format", "set memory switch CMD FORMAT to SHOT/FC")
    return Identity(model=model, firmware=firmware, serial=serial)


async def _to_host(session: Session, mode: str) -> None:
    """Leave another mode, which the unit does only when idle (L2352)."""
    if mode == "HOST,PROGRAM":
        leave = "P:H"
    elif mode == "HOST,MS":
        # MS:OFF would store what somebody has half edited (L7342).
        raise DriverFault(
            "wrong-mode",
            "the unit's memory switches are being edited",
            "finish or leave the editing (MS:OFF stores it, a power cycle drops it); it is tried again",
        )
    else:
        leave = "MODE:HOST"
    if not await session.try_to_tell(leave) or await session.ask("?:MODE", MODE) != "HOST":
        raise DriverFault(
            "wrong-mode",
            f"the unit is in mode {mode} and did not take {leave}",
            "end the program or motion that runs at its front panel and choose HOST there; it is tried again",
        )


async def controllable_axes(session: Session, clock: Clock, busy_wait_s: float) -> tuple[int, ...]:
    """Which axes can be controlled, after ending standbys; waits for motions of others, and never stops one.

    `?:AXIS` answers a digit that a completion would be taken for, so it is asked at rest only.
    """
    until_ns = clock.now_ns() + round(busy_wait_s * NS_PER_S)
    relieved = False
    while await session.ask("!:", READY) == "B":
        if not relieved:
            now = status(await session.ask("Q:SPC", STATUS), (1, 2, 3))
            valid = tuple(motor for motor, each in now.items() if each.state != "D")
            await Buffers(session, valid).end_standby({m for m in valid if now[m].busy})
            relieved = True
        elif clock.now_ns() > until_ns:
            raise DriverFault(
                "moving",
                "the unit is moving by somebody else's command",
                "wait for its end, or stop it at the unit; it is tried again",
            )
        await sleep_ns(clock, _BUSY_LOOK_NS)
    await sleep_ns(clock, _BUSY_LOOK_NS)  # a completion line of that motion may still be on its way
    return CONTROLLABLE[await session.ask("?:AXIS", CONTROLLABLE_FORM)]


async def compare(session: Session, config: Controller, options: Options, controllable: tuple[int, ...]) -> None:
    """Read back what the unit holds and load what is ours to set. Raises `DriverFault` (`config-mismatch`)."""
    motors = fleetaxes.motors(config)
    for name, motor in motors.items():
        if motor not in controllable:
            raise _mismatch(f"axis {name}: motor {motor}", f"controllable axes {_plain(controllable)}", str(motor))
    read = await session.ask("?:PW", sizes(len(controllable)))
    nm = dict(zip(controllable, map(float, read.split(",")), strict=True))
    for name, axis in config.axes.items():
        wanted = fleetaxes.expected_nm(axis, options.nm_per_pulse)
        if wanted is not None and abs(nm[motors[name]] - wanted) > 1e-6 * wanted:
            source = "nm_per_pulse" if options.nm_per_pulse is not None else f"unit {axis.unit} and scale {axis.scale}"
            raise _mismatch(f"axis {name}: nm per pulse (?:P)", f"{nm[motors[name]]:g}", f"{wanted:g} by its {source}")
    if options.loop is not None:
        digit = "1" if options.loop == "open" else "0"
        if set((await session.ask("?:FW", flags(len(controllable)))).split(",")) != {digit}:
            await session.tell(f"F:W{digit}")
    if await session.ask("?:W", SETTLING) != "0":
        await session.tell("W:0")


async def load_sentinel(session: Session, config: Controller, controllable: tuple[int, ...]) -> tuple[str, str]:
    """Load the speeds of the origin return; gives query and reply by which a lost volatile state is noticed.

    B: is volatile (L5211), and no motion changes it. R of the first axis ends in 7 or 3, which a person's setting
    in the memory switches, where the unit gets it from at power-on, hardly does; it always differs from what was there.
    """
    motors = fleetaxes.motors(config)
    first = min(motors, key=lambda name: motors[name])
    query = f"?:B{motors[first]}"
    _, _, before = triple(await session.ask(query, triples(1)))
    expected = ""
    for name, axis in config.axes.items():
        s, f, r = fleetaxes.homing_triple(axis)
        if name == first:
            r = _marked(r, before)
            expected = f"S{s}F{f}R{r}"
        await session.tell(f"B:{motors[name]}S{s}F{f}R{r}")
    if await session.ask(query, triples(1)) != expected:
        raise _mismatch(f"axis {first}: origin return speeds (?:B)", "something else", expected)
    return query, expected


def _marked(least: int, before: int) -> int:
    """A ramp of at least `least` ms (or the longest) that ends in 7 or 3 and is not `before`."""
    choices = [r for r in range(least, 1001) if r % 10 in (3, 7)] or [997, 993]
    return next(r for r in choices if r != before)


def _mismatch(item: str, found: str, wanted: str) -> DriverFault:
    return DriverFault(
        "config-mismatch",
        f"{item}: the unit has {found}, the fleet file wants {wanted}",
        "correct the fleet file, or the unit's memory switches",
    )


def _plain(motors: tuple[int, ...]) -> str:
    return ", ".join(map(str, motors))
