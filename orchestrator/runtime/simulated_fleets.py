"""Simulated fleets of benchmarks, campaign and tests, with varied links, firmware and crystals."""

from collections.abc import Mapping
from random import Random
from typing import Any

from orchestrator.model.fleet import Fleet

SPREAD_US = 50  # of a Yaskawa's firmware; its half millisecond per command is in the manuals
PP_SPREAD_MS = 15.0  # of a pp-electronic SMC, which uses a Windows tick: nothing in it is steadier
HOLD_MS = 16.0  # the latency timer of a USB serial adapter
DRIFT_PPM = 50.0
WANDER_PPM = 0.05

_SERVO = {"unit": "mm", "scale": 1000, "limits": {"velocity": 200, "acceleration": 1000}}
_STAGE = {
    "unit": "mm",
    "scale": 10_000,
    "limits": {"velocity": 8, "acceleration": 40},
    "start_rate": {"min": 0.01, "max": 0.4},
}
_STEPS = {
    "unit": "mm",
    "scale": 1000,
    "limits": {"velocity": 10, "acceleration": 50},
    "start_rate": {"min": 0.05, "max": 0.4},
}
_PULSES = {
    "unit": "counts",
    "limits": {"velocity": 80_000, "acceleration": 400_000},
    "start_rate": {"min": 100, "max": 4000},
}
_YASKAWA = {"axes": 2, "home_edge": {"X": -2000}, "index_every": {"X": 200}}
_LINE = {"inputs": {"start": {"number": 1, "active": "low"}}}


def _make_controller(
    adapter: str, link: Mapping[str, Any], axis: Mapping[str, Any], motor: str, simulate: Mapping[str, Any], **more: Any
) -> dict[str, Any]:
    homing = {"homing": {"speed": axis["limits"]["velocity"] / 5}}
    return {
        "adapter": adapter,
        "link": dict(link),
        "axes": {"x": {**axis, **homing, "motors": [motor]}},
        "simulate": dict(simulate),
        **more,
    }


def _make_serial_link(number: int, baud: int, **more: Any) -> dict[str, Any]:
    return {"kind": "serial", "device": f"/dev/ttyUSB{number}", "baud": baud, **more}


def make_smc4000(number: int) -> dict[str, Any]:
    link = {"kind": "tcp", "host": f"10.0.0.{number + 1}", "port": 23}
    simulate = {"options": _YASKAWA, "decode_us": 500, "spread_us": SPREAD_US}
    return _make_controller("smc4000", link, _SERVO, "X", simulate, **_LINE)


def make_smc2000(number: int, address: int | None = None) -> dict[str, Any]:
    """Return a controller on its own port, or with an address on a chain."""
    more = {} if address is None else {"address": address}
    simulate = {"options": _YASKAWA, "decode_us": 500, "spread_us": SPREAD_US, "hold_ms": HOLD_MS}
    return _make_controller("smc2000", _make_serial_link(number, 19200, **more), _SERVO, "X", simulate, **_LINE)


def make_shrc203(number: int) -> dict[str, Any]:
    simulate = {
        "options": {"divide": 20, "speed": [100, 20000, 100]},
        "decode_us": 1000,
        "spread_us": 800,
        "hold_ms": HOLD_MS,
    }
    options = {"nm_per_pulse": 100}
    return _make_controller(
        "shrc203", _make_serial_link(number, 38400), _STAGE, "1", simulate, options=options, **_LINE
    )


def make_smc30(number: int, address: int) -> dict[str, Any]:
    link = _make_serial_link(number, 9600, data_bits=7, parity="odd", address=address)
    simulate = {"options": {"checksum": True, "travel_steps": [-20_000, 400_000]}, "spread_us": 200, "hold_ms": HOLD_MS}
    return _make_controller("smc30", link, _STEPS, "1", simulate, **_LINE)


def make_ppsmc(number: int) -> dict[str, Any]:
    link = {"kind": "tcp", "host": f"10.0.1.{number + 1}", "port": 1234}
    options = {"axes": 1, "org_steps": {"1": [-9000, -2000]}}
    simulate = {"options": options, "decode_us": 5000, "spread_us": round(PP_SPREAD_MS * 1000)}
    return _make_controller("ppsmc", link, _PULSES, "1", simulate)


def make_cia402(number: int) -> dict[str, Any]:
    """Return the drive with this node number on a CAN bus, with measured times of its start."""
    return {
        "adapter": "cia402",
        "link": {"kind": "can", "interface": "socketcan", "channel": "can0", "address": number},
        "options": {"cycle_us": 100, "start_us": 50, "start_spread_us": 50},
        "axes": {"x": {"motors": ["1"], **_SERVO}},
        "simulate": {"options": {"objects": {"6065": 500, "6066": 0}}},
    }


def make_mixed(*, pp: bool) -> dict[str, dict[str, Any]]:
    """Return two of each make; the SMC30 share a bus."""
    controllers = {
        "a1": make_smc4000(0),
        "a2": make_smc4000(1),
        "b1": make_smc2000(0),
        "b2": make_smc2000(1),
        "c1": make_shrc203(2),
        "c2": make_shrc203(3),
        "d1": make_smc30(4, 1),
        "d2": make_smc30(4, 2),
    }
    return controllers | ({"e1": make_ppsmc(0), "e2": make_ppsmc(1)} if pp else {})


def make_wired(controllers: Mapping[str, dict[str, Any]]) -> dict[str, Any]:
    """Wire one output of the first controller to an input of all others."""
    names = list(controllers)
    first = {**controllers[names[0]], "outputs": {"start": {"number": 1}}}
    wire = {"from": f"{names[0]}.start", "to": [f"{name}.start" for name in names[1:]], "delay_us": [5, 50]}
    return {"controllers": {**controllers, names[0]: first}, "wiring": [wire]}


FLEETS: dict[str, dict[str, Any]] = {
    "8 SMC-4000": {"controllers": {f"a{k}": make_smc4000(k) for k in range(8)}},
    "2 SMC-4000": {"controllers": {f"a{k}": make_smc4000(k) for k in range(2)}},
    "8 SMC-2000, own ports": {"controllers": {f"b{k}": make_smc2000(k) for k in range(8)}},
    "8 SMC-2000, one chain": {"controllers": {f"b{k}": make_smc2000(0, k) for k in range(8)}},
    "mixed": {"controllers": make_mixed(pp=False)},
    "mixed, lines": make_wired(make_mixed(pp=False)),
    "mixed with pp": {"controllers": make_mixed(pp=True)},
    "32 SMC-4000": {"controllers": {f"a{k}": {**make_smc4000(k), "host": f"h{k // 8}"} for k in range(32)}},
    "64 SMC-4000": {"controllers": {f"a{k}": make_smc4000(k) for k in range(64)}},
}
"""Fleets by the name of their row."""


def make_sync_fleet(name: str, seed: int, **limits: float) -> Fleet:
    """Return the fleet `name` with crystals drawn by `seed`, and limits of all axes changed, e.g. `jerk`."""
    draw = Random(f"{name} {seed}")
    plain = FLEETS[name]
    controllers: dict[str, Any] = {}
    for controller, config in plain["controllers"].items():
        crystal = {
            "offset_s": draw.uniform(0, 600),
            "drift_ppm": draw.uniform(-DRIFT_PPM, DRIFT_PPM),
            "wander_ppm": WANDER_PPM,
        }
        axis = config["axes"]["x"]
        axes = {"x": {**axis, "limits": {**axis["limits"], **limits}}}
        controllers[controller] = {**config, "axes": axes, "simulate": {**config["simulate"], **crystal}}
    return Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "sync", **plain, "controllers": controllers})


def make_light(number: int, host: str) -> dict[str, Any]:
    """Return a light controller of four axes."""
    limits = {"velocity": 200, "acceleration": 1000}
    axis = {"unit": "mm", "scale": 1000, "limits": limits, "homing": {"speed": 40}}
    return {
        "adapter": "light",
        "host": host,
        "link": {"kind": "process", "device": f"light-{number}"},
        "axes": {name: {**axis, "motors": [str(motor)]} for motor, name in enumerate("xyzw", 1)},
    }


def make_light_fleet(count: int, hosts: int, seed: int = 1) -> Fleet:
    """Return a fleet of light controllers on several hosts, with crystals drawn by `seed`; all axes are its group
    `hall`."""
    draw = Random(f"light {seed}")
    controllers: dict[str, Any] = {}
    for number in range(count):
        crystal = {"offset_s": draw.uniform(0, 600), "drift_ppm": draw.uniform(-DRIFT_PPM, DRIFT_PPM)}
        config = make_light(number, f"h{number * hosts // count}")
        controllers[f"c{number}"] = {**config, "simulate": crystal}
    groups = {"hall": [f"{name}.{axis}" for name, config in controllers.items() for axis in config["axes"]]}
    return Fleet.model_validate(
        {"schema": "tutti.fleet/1", "fleet": "light", "controllers": controllers, "groups": groups}
    )
