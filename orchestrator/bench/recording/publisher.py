"""A process that publishes the states of many axes: `python -m orchestrator.bench.recording.publisher ENDPOINT FLEET
CONTROLLERS HZ SECONDS MOVING`. At the end it prints how many it has published."""

import asyncio
import sys

from orchestrator.bus.base import Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.zenoh.bus import open_bus
from orchestrator.clock.base import NS_PER_S, sleep_until_ns
from orchestrator.clock.live import LiveClock
from orchestrator.model.messages import LeaderHeartbeat
from orchestrator.model.state import AxisState, ClockQuality, ControllerState

AXES = ("x", "y", "z", "w")
COUNTS_PER_MM = 1000
HEARTBEAT_S = 0.5


def make_state(controller: str, number: int, at_ns: int, utc: str, moving: int = 2) -> ControllerState:
    """The state of a controller of four axes, of which the first `moving` ones move. at_ns: fleet time."""
    axes: dict[str, AxisState] = {}
    for index, name in enumerate(AXES):
        moves = index < moving
        counts = number * 123 * (index + 1) % 400_000 if moves else 12_500 * index
        following = 2 if moves else 0
        axes[name] = AxisState(
            position=counts / COUNTS_PER_MM,
            commanded=(counts + following) / COUNTS_PER_MM,
            velocity=12.3 * (index + 1) if moves else 0.0,
            motor_position=counts / COUNTS_PER_MM,
            raw_counts=counts,
            commanded_counts=counts + following,
            unit="mm",
            moving=moves,
            enabled=True,
            referenced=True,
        )
    return ControllerState(
        controller=controller,
        instance="host-bench-1",
        seq=number,
        utc=utc,
        fleet_ns=at_ns,
        read_fleet_ns=at_ns - 150_000,
        mode="moving",
        axes=axes,
        inputs={"door": True, "air": False},
        outputs={"lamp": False},
        faults=[],
        clock=ClockQuality(bound_ns=180_000, age_ns=number % 1000 * 1_000_000, samples=64),
        estop=None,
        epoch=1,
        digest="0123456789abcdef",
        leases={},
    )


async def publish_states(place: tuple[str, str], controllers: int, hz: float, seconds: float, moving: int = 2) -> int:
    """Publish for a time; return how many states. place: endpoint and fleet. moving: axes of each controller."""
    endpoint, fleet = place
    bus, clock, keys = await open_bus(endpoint), LiveClock(), FleetKeys(fleet)
    origin_ns = clock.now_ns()
    names = [f"c{number:02}" for number in range(controllers)]
    count, rounds = 0, round(hz * seconds)
    for number in range(rounds):
        await sleep_until_ns(clock, origin_ns + round(number * NS_PER_S / hz))
        if number % round(hz * HEARTBEAT_S) == 0:
            beat = LeaderHeartbeat(
                fleet=fleet,
                epoch=1,
                coordinator="bench",
                seq=number,
                scale_id="bench",
                kernel_id=clock.kernel_id,
                origin_host_ns=origin_ns,
                utc=clock.utc(),
            )
            bus.put(keys.leader, beat.to_json(), Priority.STATE)
        utc = clock.utc()
        for name in names:
            state = make_state(name, number, clock.now_ns() - origin_ns, utc, moving)
            bus.put(keys.state(name), state.to_json(), Priority.EVENT)  # so that none is lost on the way
            count += 1
    while bus.backlog:
        await asyncio.sleep(0.1)
    await asyncio.sleep(1.0)
    await bus.close()
    return count


if __name__ == "__main__":
    endpoint, fleet, controllers, hz, seconds, moving = sys.argv[1:]
    sent = asyncio.run(publish_states((endpoint, fleet), int(controllers), float(hz), float(seconds), int(moving)))
    sys.stdout.write(f"{sent}\n")
