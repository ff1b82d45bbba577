"""What servers of several protocols do with a whole fleet: its state in a word, e-stop and reset with their texts."""

import asyncio
from collections.abc import AsyncGenerator, Awaitable, Callable, Mapping
from contextlib import asynccontextmanager, suppress

from tutti import ControllerState, Refusal, Tutti, TuttiError, running

RELEASE_S = 2.0
LOOK_S = 0.05


def describe(error: TuttiError) -> str:
    """An error in one line, with its remedy."""
    remedy = error.remedy if isinstance(error, Refusal) else ""
    return f"{error}; {remedy}" if remedy else str(error)


def is_latched(states: Mapping[str, ControllerState]) -> bool:
    """Whether an e-stop is latched anywhere."""
    return any(state.estop is not None for state in states.values())


def describe_fleet(states: Mapping[str, ControllerState]) -> str:
    """`e-stop`, `offline`, `fault`, `moving` or `idle`: the first that is true of any controller."""
    modes = {state.mode for state in states.values()}
    if is_latched(states):
        return "e-stop"
    for mode in ("offline", "fault"):
        if mode in modes:
            return mode
    return "moving" if modes - {"idle"} else "idle"


async def estop_fleet(tutti: Tutti, reason: str) -> str:
    """Send an e-stop; return which controllers do not confirm it, empty: all do. Raises `Refusal`."""
    latches = await tutti.estop(reason)
    names = ", ".join(name for name, is_set in latches.items() if not is_set) or "any controller"
    return "" if latches and all(latches.values()) else f"no e-stop is confirmed by {names}; use the wired one"


async def reset_fleet(tutti: Tutti) -> list[Refusal]:
    """Release the e-stop, and return what refuses that; without a refusal, when states show that it is released. Raises
    `Refusal`."""
    refusals = [refusal for refusal in (await tutti.reset()).values() if refusal is not None]
    with suppress(TimeoutError):
        async with asyncio.timeout(RELEASE_S):
            while not refusals and is_latched(await tutti.status()):
                await asyncio.sleep(LOOK_S)
    return refusals


@asynccontextmanager
async def refreshing(refresh: Callable[[], Awaitable[None]], period_s: float) -> AsyncGenerator[None]:
    """Call `refresh` again and again while the context lasts. While the coordinator is away, what is known stays."""

    async def follow() -> None:
        while True:
            with suppress(TuttiError):
                await refresh()
            await asyncio.sleep(period_s)

    async with running(follow()):
        yield
