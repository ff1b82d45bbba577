"""How often a controller's adapter publishes its state: at each poll, and not much less often when it cannot poll."""

from cluster.worlds import job, outcome

from orchestrator.bus.base import BusSample
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.model.fleet import Fleet
from orchestrator.model.state import ControllerState
from orchestrator.runtime.simulated_fleets import make_smc4000
from orchestrator.runtime.virtual.fleet import VirtualFleet

SECONDS = 10


async def polled(clock: VirtualClock, **rates: float) -> VirtualFleet:
    """One controller, `a`, that is read at `rates`."""
    controllers = {"a": {**make_smc4000(0), "state": rates}}
    fleet = Fleet.model_validate({"schema": "tutti.fleet/1", "fleet": "beats", "controllers": controllers})
    virtual = VirtualFleet(fleet, clock, 1)
    await virtual.start()
    return virtual


def states_in(idle_hz: float) -> int:
    """How many states a controller at rest has published in `SECONDS`."""

    async def main(clock: VirtualClock) -> int:
        heard: list[BusSample] = []
        virtual = await polled(clock, idle_hz=idle_hz)
        await virtual.net.join_process("watcher").subscribe(virtual.keys.state(), heard.append)
        await sleep_ns(clock, SECONDS * NS_PER_S)
        return len(heard)

    return run_virtual(main)


def test_no_heartbeat_is_added_to_frequent_polls() -> None:
    assert 0.9 * SECONDS * 5 < states_in(5.0) <= SECONDS * 5


def test_a_seldom_polled_controller_still_sends_heartbeats() -> None:
    # Every second by the poll, and in between as often as silence would be noticed.
    assert 2 * SECONDS <= states_in(1.0) <= 3 * SECONDS


def test_a_member_that_received_go_is_polled_as_in_motion() -> None:
    """From its T0 on: its start, or that it is missing, is not observed one slow poll later."""

    async def main(clock: VirtualClock) -> None:
        virtual = await polled(clock, idle_hz=0.2, moving_hz=10.0)
        await outcome(virtual, job("[{do: enable, axes: [a]}, {do: home, axes: [a]}]"))
        told_ns: list[int] = []
        polled_ns: list[int] = []

        def see(data: bytes) -> bytes:
            if b"XGO=1" in data:
                told_ns.append(clock.now_ns())
            elif data.startswith(b"QR"):
                polled_ns.append(clock.now_ns())
            return data

        virtual.wires["a"].to_far = see
        for number in range(3):
            await sleep_ns(clock, number * 700 * NS_PER_MS)
            assert (
                await outcome(virtual, job(f"[{{do: move, to: {{a.x: {10 - 10 * (number % 2)}}}}}]"))
            ).state == "done"
            begun_ns = virtual.controllers["a"].commanded_motions[-1].start_ns
            after_ns = min(each for each in polled_ns if each > told_ns[-1]) - begun_ns
            assert -5 * NS_PER_MS < after_ns < NS_PER_S // 10
        assert len(told_ns) == 3

    run_virtual(main)


def test_an_armed_member_is_not_polled_before_its_start_but_at_once_after_a_stop() -> None:
    """It is otherwise polled every 20 ms: the polls of the arming suffice, and a stop must be observed to its end."""

    async def main(clock: VirtualClock) -> None:
        virtual = await polled(clock, idle_hz=50.0)
        await outcome(virtual, job("[{do: enable, axes: [a]}, {do: home, axes: [a]}]"))
        states: list[ControllerState] = []
        await virtual.net.join_process("watcher").subscribe(
            virtual.keys.state(), lambda sample: states.append(ControllerState.model_validate_json(sample.payload))
        )
        await sleep_ns(clock, NS_PER_S)
        assert len(states) > 40
        states.clear()
        begun_ns = len(virtual.controllers["a"].commanded_motions)
        moving = await virtual.make_client().submit(job("[{do: move, to: {a.x: 10}}]"))
        while len(virtual.controllers["a"].commanded_motions) == begun_ns:
            await sleep_ns(clock, NS_PER_MS)
        assert len(states) <= 2  # one that was under way, and the state of the lease
        await moving.result()

        # Stopped just after arming.
        told = len(virtual.lines)
        moving = await virtual.make_client().submit(job("[{do: move, to: {a.x: 0}, start: agreed}]"))
        while not any("job is armed" in line for line in virtual.lines[told:]):
            await sleep_ns(clock, NS_PER_MS)
        states.clear()
        await virtual.make_client().stop()
        await sleep_ns(clock, 60 * NS_PER_MS)
        assert states and states[-1].mode == "idle"

    run_virtual(main)
