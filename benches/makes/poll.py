"""The poll rate of SMC-2000 on a serial line, compared with the limit of the line's characters, in virtual time."""

import asyncio
from random import Random
from typing import NamedTuple

from adapters.contract import Driver
from benches.makes.drivers import connect_wire, make_drivers
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, Clock
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import MemoryWire, serial_wire
from orchestrator.model.fleet import Controller
from sim.core.controller import DeviceSpec, FirmwareTiming, build_line
from sim.core.oscillator import Oscillator
from sim.core.vectors import find_simulator

MAKE = "smc2000"
BAUD = 19200
AXES = {"x": "X", "y": "Y"}
FIRMWARE = FirmwareTiming(decode_ns=500_000, spread_ns=50_000)
SETTLING_POLLS = 3  # polls before the measurement: the length of a reply is known from the previous one


class PollCase(NamedTuple):
    """Controllers on the line, delay of received bytes in a serial adapter (ms), and simultaneous polls of each."""

    units: int
    hold_ms: int
    at_once: int


CASES = tuple(PollCase(*values) for values in ((1, 0, 1), (1, 16, 1), (1, 16, 2), (3, 0, 1), (3, 16, 1)))


class PollRate(NamedTuple):
    """The poll rate of one case.

    polls_s: of all controllers together.
    characters: of a poll, both directions.
    wire_polls_s: the limit of these characters, one after the other.
    share: of that limit, per cent."""

    units: int
    hold_ms: int
    at_once: int
    polls_s: float
    characters: float
    wire_polls_s: float
    share: float


def bench_poll(seconds: float, seed: int = 1) -> list[PollRate]:
    """Poll controllers of two axes for `seconds` of virtual time each."""
    return [run_virtual(lambda clock, case=case: _measure_rate(clock, case, seconds, seed)) for case in CASES]


async def _measure_rate(clock: VirtualClock, case: PollCase, seconds: float, seed: int) -> PollRate:
    units, hold_ms, at_once = case
    wire, drivers = _make_line(clock, units, hold_ms, seed)
    for driver in drivers:
        await driver.connect()
        await driver.configure()
        for _ in range(SETTLING_POLLS):
            await driver.poll()
    characters = 0

    def count_bytes(data: bytes) -> bytes:
        nonlocal characters
        characters += len(data)
        return data

    wire.to_far = wire.to_near = count_bytes
    began_ns = clock.now_ns()
    until_ns = began_ns + round(seconds * NS_PER_S)
    polls = sum(
        await asyncio.gather(*(_poll_until(clock, driver, until_ns) for driver in drivers for _ in range(at_once)))
    )
    rate = polls * NS_PER_S / (clock.now_ns() - began_ns)
    characters_per_poll = characters / polls
    line_rate = NS_PER_S / (characters_per_poll * wire.model.char_ns)
    return PollRate(
        units=units,
        hold_ms=hold_ms,
        at_once=at_once,
        polls_s=round(rate, 2),
        characters=round(characters_per_poll, 1),
        wire_polls_s=round(line_rate, 2),
        share=round(100 * rate / line_rate, 1),
    )


async def _poll_until(clock: Clock, driver: Driver, until_ns: int) -> int:
    polls = 0
    while clock.now_ns() < until_ns:
        await driver.poll()
        polls += 1
    return polls


def _make_line(clock: VirtualClock, count: int, hold_ms: int, seed: int) -> tuple[MemoryWire, list[Driver]]:
    draw = Random(seed)
    addresses = [None] if count == 1 else list(range(count))
    branches = {
        f"unit{number}": DeviceSpec(
            address,
            {"axes": 2},
            Oscillator(draw.randrange(100 * NS_PER_S), draw.uniform(-50, 50), 0.05, draw.getrandbits(32)),
            FIRMWARE,
            seed + number,
        )
        for number, address in enumerate(addresses)
    }
    line = build_line(find_simulator(MAKE), clock, branches)
    model = serial_wire(BAUD, hold_ns=hold_ms * NS_PER_MS)
    wire = connect_wire(clock, model, line.endpoint, "serial", seed)
    return wire, make_drivers(wire, {name: _make_config(branch.address) for name, branch in branches.items()})


def _make_config(address: int | None) -> Controller:
    limits = {"velocity": 100, "acceleration": 1000}
    axes = {name: {"motors": [motor], "unit": "mm", "scale": 1000, "limits": limits} for name, motor in AXES.items()}
    link = {"kind": "serial", "device": "/dev/null", "baud": BAUD, "address": address}
    return Controller.model_validate({"adapter": MAKE, "link": link, "axes": axes})
