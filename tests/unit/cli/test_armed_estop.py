"""The armed e-stop: its connection, a press, and what presses it."""

import asyncio
from itertools import count

from cluster.worlds import run_fleet

from orchestrator.bus.base import Bus
from orchestrator.bus.memory.traffic import BusTraffic
from orchestrator.cli.estop.button import CONFIRM_S, REMIND_S, EstopButton
from orchestrator.cli.estop.triggers import LineSplitter
from orchestrator.client.api import Tutti
from orchestrator.runtime.virtual.fleet import VirtualFleet


class Desk:
    """A button on the bus of a virtual fleet, and the kinds of the lines that it has shown."""

    def __init__(self, virtual: VirtualFleet) -> None:
        self._virtual = virtual
        self.said: list[tuple[str, str]] = []
        numbers = count()
        self.bus = virtual.make_client("button").bus
        self.reachable = asyncio.Event()
        self.button = EstopButton(
            None,
            "test",
            lambda: (f"e{next(numbers)}", "anna"),
            self._find_latched,
            lambda *line: self.said.append(line),
        )
        self.task = asyncio.get_running_loop().create_task(self.button.run(self._connect))

    @property
    def kinds(self) -> list[str]:
        return [kind for kind, _ in self.said]

    async def _connect(self) -> Bus:
        await self.reachable.wait()
        return self.bus

    async def _find_latched(self, bus: Bus) -> dict[str, bool]:
        return {f"demo/{name}": done for name, done in (await Tutti(bus, "demo").wait_for_latch()).items()}


def test_it_says_when_it_is_connected_and_a_press_latches_all() -> None:
    async def main(virtual: VirtualFleet) -> None:
        desk = Desk(virtual)
        desk.reachable.set()
        await asyncio.sleep(3)
        assert desk.kinds == ["not-connected", "armed"] and "demo/gantry, demo/stage" in desk.said[-1][1]
        desk.button.press()
        desk.button.press()
        await asyncio.sleep(2)
        assert desk.kinds[2:] == ["sent", "sent", "latched"]
        states = await virtual.make_client().status()
        assert {state.estop.event for state in states.values() if state.estop} == {"e0"} and len(states) == 2
        await virtual.make_client().reset()
        await asyncio.sleep(2)
        assert all(state.estop is None for state in (await virtual.make_client().status()).values())
        # It stays armed.
        desk.button.press()
        await asyncio.sleep(2)
        assert desk.kinds[-1] == "latched"
        desk.task.cancel()

    run_fleet(main)


def test_an_armed_button_lets_no_host_publish_controllers_singly() -> None:
    async def main(virtual: VirtualFleet) -> None:
        desk = Desk(virtual)
        desk.reachable.set()
        await asyncio.sleep(3)
        traffic = virtual.net.traffic = BusTraffic()
        await asyncio.sleep(3)
        assert desk.kinds[-1] == "armed"
        assert {kind for name, kind in traffic.by_kind if name.startswith("host-")} == {"states"}
        desk.task.cancel()

    run_fleet(main)


def test_it_sees_controllers_of_hosts_without_frames() -> None:
    async def main(virtual: VirtualFleet) -> None:
        desk = Desk(virtual)
        desk.reachable.set()
        old = virtual.make_client("old").bus
        await old.announce("tutti/v1/attic/live/controller/saw/1")
        for _ in range(20):
            old.put("tutti/v1/attic/ctl/saw/state", b"{}")
            await asyncio.sleep(0.2)
        assert desk.kinds[-1] == "armed" and "attic/saw, demo/gantry, demo/stage" in desk.said[-1][1]
        desk.task.cancel()

    run_fleet(main)


def test_without_a_connection_it_is_loud_and_a_press_is_sent_later() -> None:
    async def main(virtual: VirtualFleet) -> None:
        desk = Desk(virtual)
        await asyncio.sleep(2 * REMIND_S + 1)
        assert desk.kinds == ["not-connected"] * 3
        desk.button.press()
        assert desk.kinds[-1] == "not-sent" and "wired e-stop" in desk.said[-1][1]
        await asyncio.sleep(3)
        assert all(state.estop is None for state in (await virtual.make_client().status()).values())
        desk.reachable.set()
        await asyncio.sleep(3)
        assert desk.kinds[-2:] == ["latched", "armed"] or desk.kinds[-2:] == ["armed", "latched"]
        assert all(state.estop for state in (await virtual.make_client().status()).values())
        desk.task.cancel()

    run_fleet(main)


def test_a_press_into_a_lost_connection_is_not_forgotten() -> None:
    async def main(virtual: VirtualFleet) -> None:
        desk = Desk(virtual)
        desk.reachable.set()
        await asyncio.sleep(3)
        net, mine = virtual.net, desk.bus.name  # type: ignore[attr-defined]
        net.partition_net({mine}, set(net._buses) - {mine})  # pyright: ignore[reportPrivateUsage]
        desk.button.press()
        await asyncio.sleep(2 * CONFIRM_S)
        assert desk.kinds[2:4] == ["sent", "not-connected"] and set(desk.kinds[4:]) == {"not-connected"}
        net.heal_partition()
        await asyncio.sleep(3)
        assert set(desk.kinds[-2:]) == {"latched", "armed"}
        desk.task.cancel()

    run_fleet(main)


def test_a_controller_that_does_not_confirm_is_named() -> None:
    async def main(virtual: VirtualFleet) -> None:
        desk = Desk(virtual)
        desk.reachable.set()
        await asyncio.sleep(3)
        desk.button._seen["demo/lost"] = 0.0  # pyright: ignore[reportPrivateUsage]
        desk.button.press()
        await asyncio.sleep(CONFIRM_S + 3)
        assert desk.said[-1][0] == "not-latched" and "by demo/lost; use the wired" in desk.said[-1][1]
        desk.task.cancel()

    run_fleet(main)


def test_a_line_presses_and_noise_does_not() -> None:
    lines = LineSplitter()
    assert [lines.has_line(each) for each in (b"ST", b"OP", b"\r\n", b"\n", b"  \0\n", b"\0\0", b"x\ry")] == [
        False, False, True, False, False, False, True,
    ]  # fmt: skip
    assert not lines.has_line(b"z" * 1_000_000) and lines.has_line(b"\n")
