"""When a live fleet can work, and how its time relates to this computer's."""

import asyncio

from orchestrator.client.api import Tutti
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.model.state import ControllerState
from orchestrator.runtime.state.folder import UpFailed

READY_TIMEOUT_S = 30.0  # for the adoption of all controllers; takes a second on an idle machine
POLL_S = 0.05


async def wait_until_adopted(tutti: Tutti, controllers: int, limit_s: float = READY_TIMEOUT_S) -> None:
    """Wait until `controllers` of them are adopted and idle. Raises `UpFailed` with the state of each."""
    states: dict[str, ControllerState] = {}
    try:
        async with asyncio.timeout(limit_s):
            while len(states) < controllers or not all(s.epoch and s.mode == "idle" for s in states.values()):
                states = await tutti.status()
                await asyncio.sleep(POLL_S)
    except TimeoutError:
        modes = ", ".join(f"{name} is {state.mode}" for name, state in states.items()) or "no controller answers"
        raise UpFailed(f"not all controllers are ready after {limit_s:g} s: {modes}") from None


async def find_origin_host_ns(tutti: Tutti) -> int:
    """The instant of this computer's clock at which fleet time is 0, by the leader's next heartbeat."""
    async with tutti.subscribe_samples(tutti.keys.leader) as heartbeats:
        return LeaderHeartbeat.read_message((await heartbeats.get()).payload).origin_host_ns
