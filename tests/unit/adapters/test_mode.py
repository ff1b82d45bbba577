"""What a controller is said to be doing while nobody looks at it: after a stop, before a start, without a link."""

# pyright: reportPrivateUsage=false

import asyncio
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from adapters.contract import AxisReading, CannotDo, Driver, DriverFault, Reading
from adapters.controller.context import Seat
from adapters.controller.jogging import Jogging
from adapters.controller.publisher import Presenter
from adapters.controller.status import STARTING, Condition
from adapters.controller.supervisor import Unit
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.base import LinkClosed
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import JogRequest

CONFIG = Controller.model_validate(
    {
        "adapter": "smc4000",
        "link": {"kind": "tcp", "host": "127.0.0.1", "port": 1},
        "axes": {"x": {"motors": ["X"], "unit": "counts", "limits": {"velocity": 1, "acceleration": 1}}},
    }
)
STOPPED_NS, UNTIL_NS = 1000, 2000


def nothing(*_: object, **__: object) -> None:
    return None


@pytest.mark.parametrize(
    ("read_ns", "now_ns", "following", "mode"),
    [
        (900, 1100, False, "stopping"),  # read before the stop: it may have begun to move since
        (1001, 1100, False, "idle"),
        (900, 2001, False, "idle"),  # as long as it may take has passed
        (2500, 2600, True, "stopping"),  # its driver has not come to the end of the step
    ],
)
def test_who_was_told_to_stop_rests_only_when_somebody_has_seen_it(
    read_ns: int, now_ns: int, following: bool, mode: str
) -> None:
    reading = Reading(read_ns, {"x": AxisReading(0, 0.0, 0.0, moving=False, enabled=True)})
    condition = Condition(CONFIG, reading=reading, faults=[], stopped_ns=STOPPED_NS, stopping_until_ns=UNTIL_NS)
    absent: Any = None
    seat = SimpleNamespace(
        controller="c",
        config=CONFIG,
        driver=absent,
        bus=absent,
        keys=absent,
        clock=SimpleNamespace(now_ns=lambda: now_ns),
        instance="i",
    )
    presenter = Presenter(cast(Seat, seat), absent, absent, condition, lambda: None, lambda: following, dict)
    assert presenter.mode() == mode


def test_who_jogged_rests_only_when_somebody_has_seen_it() -> None:
    """The order to begin may have been on its way when the key was let go."""

    async def main(clock: VirtualClock) -> None:
        condition = Condition(CONFIG, faults=[])

        async def takes(span_ns: int, *_: object) -> None:
            await sleep_ns(clock, span_ns)

        driver = SimpleNamespace(
            capabilities=SimpleNamespace(costs=SimpleNamespace(stop_ns=NS_PER_S)),
            jog=partial(takes, NS_PER_S // 10),
            stop_axes=partial(takes, 0),
        )
        absent: Any = None
        seat = SimpleNamespace(
            controller="c", config=CONFIG, driver=driver, bus=absent, keys=absent, clock=clock, instance="i"
        )
        presenter = Presenter(cast(Seat, seat), absent, absent, condition, lambda: None, lambda: False, dict)
        condition.referenced["x"] = True
        condition.reading = Reading(clock.now_ns(), {"x": AxisReading(0, 0.0, 0.0, moving=False, enabled=True)})
        jogging = Jogging(cast(Driver, driver), clock, condition, asyncio.ensure_future, nothing)
        velocities = {"x": 0.2}
        request = JogRequest(request_id="r", actor="a", holder="hand-a", seq=1, velocities=velocities, valid_ms=50)
        await jogging.jog(request)
        assert presenter.mode() == "stopping"
        condition.reading = replace(condition.reading, at_ns=clock.now_ns())
        assert presenter.mode() == "idle"

    run_virtual(main)


TWO = CONFIG.model_copy(update={"axes": {"x": CONFIG.axes["x"], "y": CONFIG.axes["x"]}})


class Slow:
    """A driver that needs 0.15 s for each order. ordered: what it was told."""

    capabilities = SimpleNamespace(costs=SimpleNamespace(stop_ns=NS_PER_S))

    def __init__(self, clock: VirtualClock, refuses: str = "") -> None:
        self.ordered: list[str] = []
        self._clock = clock
        self._refuses = refuses

    async def jog(self, axis: str, _: object) -> None:
        await sleep_ns(self._clock, 150 * NS_PER_MS)
        self.ordered.append(axis)
        if axis == self._refuses:
            raise CannotDo("moving", "it moves", "")

    async def stop_axes(self, axes: list[str]) -> None:
        self.ordered += [f"stop {axis}" for axis in axes]


@pytest.mark.parametrize(
    ("renewed", "refuses", "told"),
    [
        (True, "", ["x", "y"]),
        (False, "", ["stop x", "stop y", "x", "stop x", "stop y"]),
        (True, "x", ["x"]),
    ],
)
def test_orders_of_several_axes_that_take_long_are_renewed_on_their_way(
    renewed: bool, refuses: str, told: list[str]
) -> None:
    async def main(clock: VirtualClock) -> None:
        at_rest = AxisReading(0, 0.0, 0.0, moving=False, enabled=True)
        condition = Condition(TWO, faults=[], reading=Reading(clock.now_ns(), {"x": at_rest, "y": at_rest}))
        condition.referenced = {"x": True, "y": True}
        driver = Slow(clock, refuses)
        jogging = Jogging(cast(Driver, driver), clock, condition, asyncio.ensure_future, nothing)

        def request(seq: int, renew: bool) -> JogRequest:
            velocities = {"x": 0.2, "y": 0.2}
            return JogRequest(
                request_id="r", actor="a", holder="h", seq=seq, velocities=velocities, renew=renew, valid_ms=100
            )

        order = asyncio.ensure_future(jogging.jog(request(1, renew=False)))
        for seq in range(2, 7):
            await sleep_ns(clock, 60 * NS_PER_MS)
            if renewed and not order.done():
                await jogging.jog(request(seq, renew=True))
        (refused,) = await asyncio.gather(order, return_exceptions=True)
        assert driver.ordered == told
        assert isinstance(refused, CannotDo) == bool(refuses)
        assert condition.jogging == (set[str]() if refuses or not renewed else {"x", "y"})

    run_virtual(main)


def test_who_is_said_to_have_come_to_rest_by_itself_is_told_to_all_the_same() -> None:
    """On a bad line it may have been another one's answer that said so."""

    async def main(clock: VirtualClock) -> None:
        at_rest = AxisReading(0, 0.0, 0.0, moving=False, enabled=True)
        condition = Condition(CONFIG, faults=[], reading=Reading(clock.now_ns(), {"x": at_rest}))
        condition.referenced["x"] = True
        driver = Slow(clock)
        jogging = Jogging(cast(Driver, driver), clock, condition, asyncio.ensure_future, nothing)
        velocities = {"x": 0.2}
        await jogging.jog(JogRequest(request_id="r", actor="a", holder="h", seq=1, velocities=velocities, valid_ms=200))
        await sleep_ns(clock, 1)
        jogging.look(Reading(clock.now_ns() + NS_PER_S, {"x": at_rest}))
        await sleep_ns(clock, 1)
        assert driver.ordered == ["x", "stop x"]
        assert condition.stop_unseen and not condition.jogging

    run_virtual(main)


def test_a_heartbeat_goes_on_until_t0_and_not_beyond_it_unseen() -> None:
    """A member that was released is believed dead after 0.7 s of silence, and its line may be taken until T0."""
    t0_ns = 3 * NS_PER_S

    async def main(clock: VirtualClock) -> list[int]:
        beats: list[int] = []

        def publish() -> None:
            beats.append(clock.now_ns())
            presenter.published_ns = clock.now_ns()

        presenter = SimpleNamespace(published_ns=0, mode=lambda: "moving", publish=publish)
        unit = SimpleNamespace(
            _config=CONFIG,
            _clock=clock,
            _presenter=presenter,
            _member=SimpleNamespace(ticket=SimpleNamespace(t0_host_ns=clock.now_ns() + t0_ns)),
        )
        began_ns = presenter.published_ns = clock.now_ns()
        beating = asyncio.ensure_future(Unit._beat(cast(Unit, unit)))
        await sleep_ns(clock, 2 * t0_ns)
        beating.cancel()
        return [at_ns - began_ns for at_ns in (began_ns, *beats)]

    beats = run_virtual(main)
    assert max(b - a for a, b in zip(beats, [*beats[1:], t0_ns], strict=True)) < 0.5 * NS_PER_S
    assert beats[-1] < t0_ns


@pytest.mark.parametrize(
    ("read_ns", "moving", "member", "owed"),
    [
        (900, False, "", True),
        (1001, True, "", True),
        (1001, False, "following", True),
        (1001, False, "loading", True),
        (1001, False, "stop_owed", True),
        (1001, False, "", False),
    ],
)
def test_a_stop_is_owed_when_the_link_breaks_before_anybody_has_seen_what_it_did(
    read_ns: int, moving: bool, member: str, owed: bool
) -> None:
    """What it was told may have been lost with the link; until it is seen again it may move."""
    reading = Reading(read_ns, {"x": AxisReading(0, 0.0, 0.0, moving, enabled=True)})
    condition = Condition(CONFIG, reading=reading, stopped_ns=STOPPED_NS, may_move=False)
    parts = ("following", "loading", "stop_owed")
    unit = SimpleNamespace(
        controller="c",
        _condition=condition,
        _member=SimpleNamespace(ticket=None, lost=nothing, **{each: each == member for each in parts}),
        _jogging=SimpleNamespace(ended_all=nothing),
        _presenter=SimpleNamespace(emit=nothing),
        _log=SimpleNamespace(warning=nothing),
        _stop_owed=False,
    )
    Unit._offline(cast(Unit, unit), STARTING)
    assert unit._stop_owed is owed
    assert condition.may_move is owed


def test_a_stop_that_is_owed_is_given_again_until_somebody_answers_behind_it() -> None:
    """What was written into a line that is still broken is lost."""
    told: list[str] = []

    class Broken:
        async def stop_first(self) -> bool:
            told.append("stop")
            return True

        async def stop(self, abort: bool) -> None:
            assert not abort
            told.append("stop again")

        async def connect(self) -> None:
            told.append("connect")
            if told.count("connect") < 3:
                raise DriverFault("no-answer", "nothing came", "")

    async def loaded() -> None:
        return None

    async def main(_: VirtualClock) -> None:
        unit = SimpleNamespace(
            _stop_owed=True,
            _driver=Broken(),
            _condition=Condition(CONFIG),
            _member=SimpleNamespace(loaded=loaded),
            _presenter=SimpleNamespace(emit=lambda kind, _: told.append(kind)),
        )
        unit._pay_owed_stop = partial(Unit._pay_owed_stop, cast(Unit, unit))
        for _ in range(2):
            with pytest.raises(DriverFault):
                await Unit._reach(cast(Unit, unit))
            assert unit._stop_owed
        for _ in range(2):
            await Unit._reach(cast(Unit, unit))
            assert not unit._stop_owed

    run_virtual(main)
    assert told == [*["stop", "connect"] * 3, "stop again", "stopped", "connect"]


@pytest.mark.parametrize("lost_ms", [0, 50])
def test_who_is_asked_while_it_is_being_met_is_not_online_yet(lost_ms: int) -> None:
    """A command may find a controller that answers already, whose program is still being looked at; or its poll waits
    for its turn on a line that is lost and met again meanwhile."""
    taken: list[int] = []

    async def main(clock: VirtualClock) -> None:
        async def poll() -> Reading:
            await sleep_ns(clock, 100 * NS_PER_MS)
            return Reading(clock.now_ns(), {})

        unit = SimpleNamespace(
            _driver=SimpleNamespace(poll=poll),
            _met=lost_ms > 0,
            _take=lambda reading: taken.append(reading.at_ns),
            _presenter=SimpleNamespace(publish=nothing),
        )
        refreshing = asyncio.ensure_future(Unit.refresh(cast(Unit, unit)))
        await sleep_ns(clock, lost_ms * NS_PER_MS)
        unit._met = False
        with pytest.raises(LinkClosed, match="still to be met"):
            await refreshing
        unit._met = True
        await Unit.refresh(cast(Unit, unit))

    run_virtual(main)
    assert len(taken) == 1


@pytest.mark.parametrize(("by_hand", "until_ns"), [("", 7), ("jogging", None), ("homing", None)])
def test_who_is_moved_by_hand_is_polled_whatever_else_is_asked_of_it(by_hand: str, until_ns: int | None) -> None:
    condition = Condition(CONFIG, faults=[])
    if by_hand:
        getattr(condition, by_hand).add("x")
    unit = SimpleNamespace(_condition=condition, _member=SimpleNamespace(quiet_until_ns=lambda: 7))
    assert Unit._quiet_until_ns(cast(Unit, unit)) == until_ns
