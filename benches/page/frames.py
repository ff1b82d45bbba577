"""Frames of the stream for a fleet whose axes all move, made without a fleet."""

from typing import Any

from orchestrator.bench.recording.publisher import make_state
from orchestrator.bus.base import BusSample
from orchestrator.bus.keys import FleetKeys
from orchestrator.clock.live import LiveClock
from orchestrator.gateway.stream.fleet_state import FleetState
from orchestrator.gateway.stream.merge_patch import make_patch
from orchestrator.gateway.stream.stream_view import encode

HELLO = {
    "fleet": "bench",
    "version": "bench",
    "user": None,
    "role": "viewer",
    "users": False,
    "csrf": "",
    "may": ["stop", "estop"],
}


def make_frames(fleet: str, controllers: int, count: int) -> tuple[str, list[str]]:
    """The state, and `count` differences that can be fed again and again; each without its number and braces."""
    clock, keys = LiveClock(), FleetKeys(fleet)
    state = FleetState(keys, clock)
    names = [f"c{number:02}" for number in range(controllers)]

    def compose(number: int) -> dict[str, Any]:
        for name in names:
            state_message = make_state(name, number, number * 50_000_000, clock.utc(), moving=4)
            state.take_sample(BusSample(keys.state(name), state_message.to_json()))
        return state.compose()

    old_state = first = compose(0)
    patches: list[str] = []
    for number in range(1, count + 1):
        new_state = compose(number)
        patches.append(f'"patch":{encode(make_patch(old_state, new_state))}')
        old_state = new_state
    return f'"state":{encode(first)}', patches
