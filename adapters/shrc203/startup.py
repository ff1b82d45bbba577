"""Connection to a controller in any state, and comparison of its settings with the fleet file."""

from adapters.contract import ControllerIdentity
from adapters.shrc203 import fleetaxes
from adapters.shrc203.buffers import PrebufferControl
from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.wire.replies import (
    AXES_BY_CODE,
    CONTROLLABLE,
    FORMAT,
    IDENTITY,
    MODE,
    READY,
    SETTLING,
    STATUS,
    flag_list,
    parse_status,
    parse_triple,
    size_list,
    speed_list,
)
from adapters.shrc203.wire.session import ShrcSession
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock, sleep_ns
from orchestrator.model.errors import ControllerFault
from orchestrator.model.fleet import Controller

_BUSY_POLL_NS = 100 * NS_PER_MS


async def identify_controller(session: ShrcSession) -> ControllerIdentity:
    """Switch the controller to HOST mode and SHOT/FC format and query its identity. Raises `ControllerFault`."""
    identity = (await session.send_query("*IDN?", IDENTITY)).split(",")
    _, model, serial, firmware = identity
    if model != "SHRC-203":
        raise ControllerFault(
            "wrong-make",
            f"{session.link.endpoint} is {','.join(identity)}, not an SHRC-203",
            "correct `adapter` or `link` in the fleet file",
        )
    mode = await session.send_query("?:MODE", MODE)
    if mode != "HOST":
        session.log.info(f"the controller is in mode {mode}; switching to HOST")
        await _enter_host_mode(session, mode)
    if await session.send_query("?:FMT", FORMAT) != "SHOT_FC" and not await session.try_setting("FMT:SHOT_FC"):
        raise ControllerFault(
            "wrong-format", "the controller stays in HIT format", "set memory switch CMD FORMAT to SHOT/FC"
        )
    return ControllerIdentity(model=model, firmware=firmware, serial=serial)


async def _enter_host_mode(session: ShrcSession, mode: str) -> None:
    """Leave another mode, which the controller does only when idle (L2352)."""
    if mode == "HOST,PROGRAM":
        leave = "P:H"
    elif mode == "HOST,MS":
        # MS:OFF would store a half-edited setting (L7342).
        raise ControllerFault(
            "wrong-mode",
            "the controller's memory switches are being edited",
            "finish or leave the editing (MS:OFF stores it, a power cycle discards it); the adapter keeps retrying",
        )
    else:
        leave = "MODE:HOST"
    if not await session.try_setting(leave) or await session.send_query("?:MODE", MODE) != "HOST":
        raise ControllerFault(
            "wrong-mode",
            f"the controller is in mode {mode} and did not accept {leave}",
            "end the program or motion that runs at its front panel and select HOST there; the adapter keeps retrying",
        )


async def controllable_axes(session: ShrcSession, clock: Clock, busy_wait_s: float) -> tuple[int, ...]:
    """Return the controllable axes, after ending input waits; wait for motions begun elsewhere, and never stop one.

    The answer of `?:AXIS` is a digit like a completion's, so it is queried at rest only.
    """
    until_ns = clock.now_ns() + round(busy_wait_s * NS_PER_S)
    is_relieved = False
    while await session.send_query("!:", READY) == "B":
        if not is_relieved:
            session.log.info("the controller is busy; ending input waits of an earlier session")
            states = parse_status(await session.send_query("Q:SPC", STATUS), (1, 2, 3))
            valid = tuple(motor for motor, state in states.items() if state.state != "D")
            await PrebufferControl(session, valid).end_input_waits({m for m in valid if states[m].is_busy})
            is_relieved = True
        elif clock.now_ns() > until_ns:
            raise ControllerFault(
                "moving",
                "the controller is moving by another client's command",
                "wait for its end, or stop it at the controller; the adapter keeps retrying",
            )
        await sleep_ns(clock, _BUSY_POLL_NS)
    await sleep_ns(clock, _BUSY_POLL_NS)  # a completion line of that motion may still be under way
    return AXES_BY_CODE[await session.send_query("?:AXIS", CONTROLLABLE)]


async def compare_settings(
    session: ShrcSession, config: Controller, options: ShrcOptions, controllable: tuple[int, ...]
) -> None:
    """Read back the controller's settings and load those that the adapter may set. Raises `ControllerFault`
    (`config-mismatch`)."""
    motors = fleetaxes.motor_numbers(config)
    for name, motor in motors.items():
        if motor not in controllable:
            raise _mismatch_fault(
                f"axis {name}: motor {motor}", f"controllable axes {_list_motors(controllable)}", str(motor)
            )
    reply = await session.send_query("?:PW", size_list(len(controllable)))
    nm = dict(zip(controllable, map(float, reply.split(",")), strict=True))
    for name, axis in config.axes.items():
        wanted_nm = fleetaxes.expected_nm(axis, options.nm_per_pulse)
        if wanted_nm is not None and abs(nm[motors[name]] - wanted_nm) > 1e-6 * wanted_nm:
            source = "nm_per_pulse" if options.nm_per_pulse is not None else f"unit {axis.unit} and scale {axis.scale}"
            raise _mismatch_fault(
                f"axis {name}: nm per pulse (?:P)", f"{nm[motors[name]]:g}", f"{wanted_nm:g} by its {source}"
            )
    if options.loop is not None:
        digit = "1" if options.loop == "open" else "0"
        if set((await session.send_query("?:FW", flag_list(len(controllable)))).split(",")) != {digit}:
            session.log.info(f"setting all axes to {options.loop} loop")
            await session.send_setting(f"F:W{digit}")
    if await session.send_query("?:W", SETTLING) != "0":
        await session.send_setting("W:0")


async def load_sentinel(session: ShrcSession, config: Controller, controllable: tuple[int, ...]) -> tuple[str, str]:
    """Load the speeds of the origin return; return query and reply by which a loss of the volatile state is detected.

    B: is volatile (L5211), and no motion changes it. R of the first axis ends in 7 or 3, which is unlikely in the
    memory switches, from which the controller loads it at power-on; it always differs from the previous value.
    """
    motors = fleetaxes.motor_numbers(config)
    first = min(motors, key=lambda name: motors[name])
    query = f"?:B{motors[first]}"
    _, _, old_ramp = parse_triple(await session.send_query(query, speed_list(1)))
    marked_speeds = ""
    for name, axis in config.axes.items():
        s, f, r = fleetaxes.homing_triple(axis)
        if name == first:
            r = _marked_ramp(r, old_ramp)
            marked_speeds = f"S{s}F{f}R{r}"
        await session.send_setting(f"B:{motors[name]}S{s}F{f}R{r}")
    if await session.send_query(query, speed_list(1)) != marked_speeds:
        raise _mismatch_fault(f"axis {first}: origin return speeds (?:B)", "something else", marked_speeds)
    return query, marked_speeds


def _marked_ramp(least: int, before: int) -> int:
    """Return a ramp of at least `least` ms (or the longest) that ends in 7 or 3 and is not `before`."""
    choices = [r for r in range(least, 1001) if r % 10 in (3, 7)] or [997, 993]
    return next(r for r in choices if r != before)


def _mismatch_fault(item: str, found: str, wanted: str) -> ControllerFault:
    return ControllerFault(
        "config-mismatch",
        f"{item}: the controller has {found}, the fleet file requires {wanted}",
        "correct the fleet file, or the controller's memory switches",
    )


def _list_motors(motors: tuple[int, ...]) -> str:
    return ", ".join(map(str, motors))
