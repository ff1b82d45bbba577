"""Drivers on wires to simulated controllers, and their moves, as an adapter host and a coordinator run them."""

import asyncio
from collections.abc import Mapping, Sequence
from contextvars import copy_context
from random import Random
from typing import Any

from adapters.contract import Driver, DriverSetup, Lowered
from adapters.host.makes import find_make
from adapters.toolkit.firing import LoopTimedWriter
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.virtual import VirtualClock
from orchestrator.link.memory import LinkAcceptor, MemoryWire, WireModel
from orchestrator.model.fleet import Controller

MAX_WAKE_DELAY_US = 60  # largest wake-up delay of a process that writes at an instant


def connect_wire(clock: VirtualClock, model: WireModel, far: LinkAcceptor, port: str, seed: int) -> MemoryWire:
    """Return a wire to a simulated controller, or to the line of several."""
    return MemoryWire(
        clock=clock, model=model, far=far, port=port, endpoint="bench", far_context=copy_context(), seed=seed
    )


def make_drivers(wire: MemoryWire, configs: Mapping[str, Controller], draw: Random | None = None) -> list[Driver]:
    """Return the drivers of controllers on one wire. configs: by name of the controller. draw: of the delays by which
    their timed writes are late; None: they are exact."""
    clock, shared_state = wire.clock, dict[str, Any]()
    writer = LoopTimedWriter(clock)
    if draw is not None:
        writer = LoopTimedWriter(clock, lambda: draw.randrange(MAX_WAKE_DELAY_US * NS_PER_US))
    drivers: list[Driver] = []
    for name, config in configs.items():
        make = find_make(config.adapter)
        setup = DriverSetup(
            controller=name,
            config=config,
            options=make.options_model.model_validate(config.options),
            clock=clock,
            open_link=wire.open_link,
            timed_writer=writer,
            shared=shared_state,
        )
        drivers.append(make.create_driver(setup))
    return drivers


async def load_moves(drivers: Sequence[Driver], lowered_profiles: Sequence[Lowered], t0_ns: int) -> None:
    """Load a move into each driver, all at once."""
    pairs = zip(drivers, lowered_profiles, strict=True)
    await asyncio.gather(*(driver.slots.present.load(lowering, t0_ns, None) for driver, lowering in pairs))


async def release_moves(drivers: Sequence[Driver]) -> None:
    """Verify the loaded moves, and release them."""
    await asyncio.gather(*(driver.slots.present.verify() for driver in drivers))
    await asyncio.gather(*(driver.slots.present.release() for driver in drivers))
