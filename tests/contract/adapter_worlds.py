"""The cases of the contract suite: one simulated controller of each of our makes and links."""

from collections.abc import Awaitable, Callable, Mapping
from dataclasses import replace
from typing import Any

from orchestrator.conformance.worlds import Case, World, run_case

SERVO = {"unit": "mm", "scale": 1000, "limits": {"velocity": 80, "acceleration": 400}}
STEPPER = {
    "unit": "mm",
    "scale": 10_000,
    "limits": {"velocity": 8, "acceleration": 40},
    "start_rate": {"min": 0.01, "max": 0.4},
    "homing": {"speed": 2},
}
TCP = {"kind": "tcp", "host": "127.0.0.1", "port": 1}
YASKAWA = {"home_edge": {"X": -2000, "Y": -1500}, "index_every": {"X": 200, "Y": 200}}


def case(
    adapter: str,
    link: Mapping[str, Any],
    axes: Mapping[str, str],
    kind: Mapping[str, Any],
    simulate: Mapping[str, Any],
    port: str,
    **options: Any,
) -> Case:
    config = {
        "adapter": adapter,
        "link": dict(link),
        "options": options,
        "axes": {name: {**kind, "motors": [motor]} for name, motor in axes.items()},
        "inputs": {"line": {"number": 1, "active": "low"}},
        "outputs": {"line": {"number": 1}},
    }
    return Case(config, simulate, port)


STEPS = {
    "unit": "mm",
    "scale": 1000,
    "limits": {"velocity": 10, "acceleration": 50},
    "start_rate": {"min": 0.05, "max": 0.4},
    "homing": {"speed": 1.5},
}
SMC30_LINK = {"kind": "serial", "device": "/dev/ttyS0", "baud": 9600, "data_bits": 7, "parity": "odd"}
SMC30_ENDS = {"travel_steps": [-20_000, 200_000]}
PULSES = {
    "unit": "counts",
    "limits": {"velocity": 80_000, "acceleration": 400_000},
    "start_rate": {"min": 100, "max": 4000},
    "homing": {"speed": 20_000},
}
ORG = {"axes": 2, "hardware": ["io_port"], "org_steps": {"1": [-9000, -2000], "2": [-9000, -1500]}}
STAGE = {"divide": 20, "speed": [100, 20000, 100]}
CAN = {"kind": "can", "interface": "socketcan", "channel": "can0", "bitrate": 1_000_000, "address": 3}
DRIVE = {**SERVO, "homing": {"method": "home_switch_negative"}}
SMOOTH = {**DRIVE, "limits": {"velocity": 80, "acceleration": 400, "jerk": 8000}}
PROMPT = {"cycle_us": 100, "start_us": 50, "start_spread_us": 50}
SWITCH = {"home_switch": [-3000, -2000]}
CHAINED = case(
    "smc2000",
    {"kind": "serial", "device": "/dev/ttyS0", "baud": 19200, "address": 1},
    {"x": "X", "y": "Y"},
    SERVO,
    {"axes": 2, **YASKAWA},
    "serial",
)
CASES = {
    "smc4000 on TCP": case("smc4000", TCP, {"x": "X", "y": "Y"}, SERVO, {"axes": 2, **YASKAWA}, "tcp"),
    "smc4000 on UDP": case(
        "smc4000", {**TCP, "kind": "udp"}, {"x": "X", "y": "Y"}, SERVO, {"axes": 2, **YASKAWA}, "udp"
    ),
    "smc4000 on serial": case(
        "smc4000",
        {"kind": "serial", "device": "/dev/ttyS0", "baud": 19200},
        {"x": "X", "y": "Y"},
        SERVO,
        {"axes": 2, **YASKAWA},
        "serial",
    ),
    "galil dmc40x0": case("galil", TCP, {"x": "X", "y": "Y"}, SERVO, {"axes": 2, **YASKAWA}, "tcp", family="dmc40x0"),
    "galil dmc21x3": case(
        "galil",
        TCP,
        {"x": "X", "y": "Y"},
        SERVO,
        {"axes": 2, "family": "dmc21x3", **YASKAWA},
        "tcp",
        family="dmc21x3",
    ),
    "smc2000 on serial": case(
        "smc2000",
        {"kind": "serial", "device": "/dev/ttyS0", "baud": 19200},
        {"x": "X", "y": "Y"},
        SERVO,
        {"axes": 2, **YASKAWA},
        "serial",
    ),
    "smc2000 in a chain of two": replace(CHAINED, beside=(0,)),
    "smc2000 in a chain of three": replace(CHAINED, beside=(0, 2)),
    "shrc203 on serial": case(
        "shrc203",
        {"kind": "serial", "device": "/dev/ttyS0", "baud": 38400},
        {"u": "1", "v": "2"},
        STEPPER,
        STAGE,
        "serial",
        nm_per_pulse=100,
    ),
    "shrc203 behind a TCP bridge": case(
        "shrc203", TCP, {"u": "1", "v": "2"}, STEPPER, STAGE, "serial", nm_per_pulse=100
    ),
    "smc30 on serial": case(
        "smc30", SMC30_LINK, {"u": "1"}, STEPS, {**SMC30_ENDS, "checksum": False}, "serial", checksum=False
    ),
    "smc30, seven on a bus with checksum": replace(
        case("smc30", {**SMC30_LINK, "address": 3}, {"u": "1"}, STEPS, {**SMC30_ENDS, "checksum": True}, "serial"),
        beside=(1, 2, 4, 5, 6, 7),
    ),
    "ppsmc on TCP": case(
        "ppsmc", TCP, {"u": "1", "v": "2"}, PULSES, ORG, "tcp", decode_us=750, decode_spread_us=250, io_port=True
    ),
    "ppsmc on serial": case(
        "ppsmc",
        {"kind": "serial", "device": "/dev/ttyS0", "baud": 9600},
        {"u": "1", "v": "2"},
        PULSES,
        ORG,
        "serial",
        decode_us=750,
        decode_spread_us=250,
        io_port=True,
    ),
    "cia402 alone": case("cia402", CAN, {"u": "1"}, DRIVE, SWITCH, "can"),
    "cia402, four on one bus": replace(case("cia402", CAN, {"u": "1"}, DRIVE, SWITCH, "can"), beside=(1, 2, 120)),
    "cia402, streamed to, two on one bus": replace(
        case("cia402", CAN, {"u": "1"}, SMOOTH, SWITCH, "can"), beside=(120,), led=True
    ),
    # Of one number: messages of one bus must not be taken for the other's. No SYNC is for both; they start together
    # only because each is written at the instant.
    "cia402, two on two buses": replace(
        case("cia402", CAN, {"u": "1"}, DRIVE, SWITCH, "can", **PROMPT),
        also=(case("cia402", {**CAN, "channel": "can1"}, {"v": "1"}, DRIVE, SWITCH, "can", **PROMPT),),
    ),
}


def run(name: str, main: Callable[[World], Awaitable[None]], seed: int = 0, ppm: float = 40.0) -> None:
    """Run `main` with the world of a case."""
    run_case(CASES[name], main, seed, ppm)
