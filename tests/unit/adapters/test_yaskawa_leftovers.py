"""State and replies that stood before an order are not taken for its result."""

import asyncio
from typing import Any

from unit.adapters.test_smc4000_bench import World, run, trapezoid

from adapters.yaskawa.wire.exchange import SmcCommandRefused
from adapters.yaskawa.wire.session import CommandSession, session_tag
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.link.base import ReceivedBytes

HOME = {"home_edge": {"X": 12_000}, "index_every": {"X": 5_000}}


def test_a_record_from_before_a_search_began_is_not_its_end():
    """The stop code of the last search stands until the next one begins, at a sample after BG."""

    async def main(world: World) -> None:
        await world.ready()
        device: Any = world.driver
        device = device._device
        read = device.read_record
        found: list[str] = []
        begun_ns = 0
        stale: Any = None

        async def read_late() -> Any:
            record = await read()
            if not begun_ns or world.clock.now_ns() - begun_ns > 2 * NS_PER_MS:
                return record
            return stale

        begin = device.begin_motion

        async def begin_late(*arguments: Any) -> None:
            nonlocal begun_ns
            await begin(*arguments)
            begun_ns = world.clock.now_ns()

        await world.driver.home_axes(["x"], found.append)
        assert found == ["x"]
        stale = await read()
        await world.driver.load_soft_limits({"x": None})
        await world.talk("PRX=-3000")
        await world.talk("BGX")
        await asyncio.sleep(2)
        stale = stale._replace(axes=(await read()).axes)
        stale = stale._replace(
            axes=(stale.axes[0]._replace(stop_code=10), *stale.axes[1:])  # as after the search before
        )
        device.read_record, device.begin_motion = read_late, begin_late
        began_ns = world.clock.now_ns()
        await world.driver.home_axes(["x"], found.append)
        assert found == ["x", "x"]
        assert world.controller.at_rest()
        assert world.clock.now_ns() - began_ns > 100 * NS_PER_MS
        assert (await read()).axes[0].commanded == 0

    run(main, options=HOME)


class DelayedLink:
    """A port on which a former client's marker is answered before the new one, because a trippoint delayed it."""

    endpoint, char_ns = "port", 0

    def __init__(self) -> None:
        self._answers: asyncio.Queue[bytes] = asyncio.Queue()
        self._answer(b"<1>\r\n:")

    def _answer(self, data: bytes, after_s: float = 0.0) -> None:
        asyncio.get_running_loop().call_later(after_s, self._answers.put_nowait, data)

    def write(self, data: bytes) -> int:
        for line in data.split(b"\r"):
            if line.startswith(b'MG "'):
                self._answer(line[4:-1] + b"\r\n:", 0.01)
            elif line == b"TC1":
                self._answer(b"1 Unrecognized Command\r\n:", 0.01)
            elif line == b"BAD":
                self._answer(b"?", 0.01)
        return 0

    async def read(self) -> ReceivedBytes:
        return ReceivedBytes(await self._answers.get(), 0)


def test_the_answer_to_a_former_clients_marker_does_not_shift_all_later_replies():
    async def main() -> None:
        link: Any = DelayedLink()
        session = CommandSession(link, 1.0, session_tag(123 * NS_PER_MS))
        try:
            await session.send_command("BAD")
        except SmcCommandRefused as refusal:
            assert refusal.number == 1
        else:
            raise AssertionError("the refusal was taken for the reply to something else")

    asyncio.run(main())


def test_sessions_that_begin_at_other_times_have_other_markers():
    assert session_tag(0) != session_tag(NS_PER_MS) != session_tag(26 * NS_PER_MS)
    assert len({session_tag(each * 977 * NS_PER_MS) for each in range(600)}) == 600


def test_a_watchdog_that_fired_in_an_earlier_step_is_not_the_reason_of_a_later_stop():
    async def main(world: World) -> None:
        await world.ready()
        await world.driver.send_raw("XDOG=1")  # as it leaves it
        moving = asyncio.ensure_future(world.moved({"x": trapezoid(0, 90_000, 40_000, 400_000)}))
        await sleep_ns(world.clock, NS_PER_S)
        await world.driver.stop(abort=False)
        outcome = (await moving)[2]
        assert outcome.state == "stopped"
        assert "watchdog" not in outcome.reason

    run(main)
