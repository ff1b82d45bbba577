"""The reported mode of a controller that is not being observed: after a stop, before a start, without a link."""

# pyright: reportPrivateUsage=false

import asyncio
from dataclasses import replace
from functools import partial
from types import SimpleNamespace
from typing import Any, cast

import pytest

from adapters.contract import AxisReading, ControllerReading, Driver
from adapters.controller.manual.jogging import JogControl
from adapters.controller.monitoring.polling import StatePolling
from adapters.controller.pending_stop import PendingStop
from adapters.controller.publishing.publisher import StatePublisher, StateSources
from adapters.controller.state.background import BackgroundTasks
from adapters.controller.state.context import ControllerContext
from adapters.controller.state.loaded_steps import LoadedSteps
from adapters.controller.state.poll_timer import PollTimer
from adapters.controller.state.status import STARTING, ControllerStatus
from adapters.controller.supervisor import ControllerSupervisor
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, sleep_ns
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.base import LinkClosed
from orchestrator.model.errors import ControllerFault, Refusal
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


def loaded_steps(*, following: bool = False) -> LoadedSteps:
    """No step; following: the driver has not come to the end of one."""
    driver: Any = SimpleNamespace(slots=None)
    steps = LoadedSteps(driver)
    steps.followed_steps = int(following)
    return steps


def nothing(*_: object, **__: object) -> None:
    return None


@pytest.mark.parametrize(
    ("read_ns", "now_ns", "following", "mode"),
    [
        (900, 1100, False, "stopping"),  # read before the stop: it may have started to move since
        (1001, 1100, False, "idle"),
        (900, 2001, False, "idle"),  # as long as it may take has passed
        (2500, 2600, True, "stopping"),  # its driver has not come to the end of the step
    ],
)
def test_a_stopped_controller_is_at_rest_only_after_a_poll_confirms_it(
    read_ns: int, now_ns: int, following: bool, mode: str
) -> None:
    reading = ControllerReading(read_ns, {"x": AxisReading(0, 0.0, 0.0, moving=False, enabled=True)})
    condition = ControllerStatus(CONFIG, reading=reading, faults=[], stopped_ns=STOPPED_NS, stopping_until_ns=UNTIL_NS)
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
    presenter = StatePublisher(
        cast(ControllerContext, seat),
        StateSources(absent, absent, condition, loaded_steps(following=following), absent),
    )
    assert presenter.current_mode() == mode


def test_a_jogged_controller_is_at_rest_only_after_a_poll_confirms_it() -> None:
    """The start command may have been on its way when the key was released."""

    async def main(clock: VirtualClock) -> None:
        condition = ControllerStatus(CONFIG, faults=[])

        async def takes(span_ns: int, *_: object) -> None:
            await sleep_ns(clock, span_ns)

        driver = SimpleNamespace(
            capabilities=SimpleNamespace(costs=SimpleNamespace(stop_ns=NS_PER_S)),
            jog_axis=partial(takes, NS_PER_S // 10),
            stop_axes=partial(takes, 0),
        )
        absent: Any = None
        seat = SimpleNamespace(
            controller="c", config=CONFIG, driver=driver, bus=absent, keys=absent, clock=clock, instance="i"
        )
        presenter = StatePublisher(
            cast(ControllerContext, seat),
            StateSources(absent, absent, condition, loaded_steps(), absent),
        )
        condition.referenced["x"] = True
        condition.reading = ControllerReading(
            clock.now_ns(), {"x": AxisReading(0, 0.0, 0.0, moving=False, enabled=True)}
        )
        jogging = JogControl(
            cast(Driver, driver),
            clock,
            condition,
            cast(BackgroundTasks, SimpleNamespace(spawn=asyncio.ensure_future)),
            PollTimer(clock),
        )
        velocities = {"x": 0.2}
        request = JogRequest(request_id="r", actor="a", holder="manual-a", seq=1, velocities=velocities, valid_ms=50)
        await jogging.apply_request(request)
        assert presenter.current_mode() == "stopping"
        condition.reading = replace(condition.reading, at_ns=clock.now_ns())
        assert presenter.current_mode() == "idle"

    run_virtual(main)


TWO = CONFIG.model_copy(update={"axes": {"x": CONFIG.axes["x"], "y": CONFIG.axes["x"]}})


class Slow:
    """A driver that needs 0.15 s for each command. ordered: the commands that it received."""

    capabilities = SimpleNamespace(costs=SimpleNamespace(stop_ns=NS_PER_S))

    def __init__(self, clock: VirtualClock, refuses: str = "") -> None:
        self.ordered: list[str] = []
        self._clock = clock
        self._refuses = refuses

    async def jog_axis(self, axis: str, _: object) -> None:
        await sleep_ns(self._clock, 150 * NS_PER_MS)
        self.ordered.append(axis)
        if axis == self._refuses:
            raise Refusal("moving", "it moves", "")

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
def test_slow_jog_commands_of_several_axes_are_renewed_before_their_answers(
    renewed: bool, refuses: str, told: list[str]
) -> None:
    async def main(clock: VirtualClock) -> None:
        at_rest = AxisReading(0, 0.0, 0.0, moving=False, enabled=True)
        condition = ControllerStatus(
            TWO, faults=[], reading=ControllerReading(clock.now_ns(), {"x": at_rest, "y": at_rest})
        )
        condition.referenced = {"x": True, "y": True}
        driver = Slow(clock, refuses)
        jogging = JogControl(
            cast(Driver, driver),
            clock,
            condition,
            cast(BackgroundTasks, SimpleNamespace(spawn=asyncio.ensure_future)),
            PollTimer(clock),
        )

        def request(seq: int, renew: bool) -> JogRequest:
            velocities = {"x": 0.2, "y": 0.2}
            return JogRequest(
                request_id="r", actor="a", holder="h", seq=seq, velocities=velocities, renew=renew, valid_ms=100
            )

        order = asyncio.ensure_future(jogging.apply_request(request(1, renew=False)))
        for seq in range(2, 7):
            await sleep_ns(clock, 60 * NS_PER_MS)
            if renewed and not order.done():
                await jogging.apply_request(request(seq, renew=True))
        (refused,) = await asyncio.gather(order, return_exceptions=True)
        assert driver.ordered == told
        assert isinstance(refused, Refusal) == bool(refuses)
        assert condition.jogging == (set[str]() if refuses or not renewed else {"x", "y"})

    run_virtual(main)


@pytest.mark.parametrize("enabled", [True, False])
def test_a_controller_reported_at_rest_or_off_by_itself_is_stopped_nevertheless(*, enabled: bool) -> None:
    """On a bad line another controller's answer may have been taken for its own, or an answer be wrong."""

    async def main(clock: VirtualClock) -> None:
        at_rest = AxisReading(0, 0.0, 0.0, moving=False, enabled=True)
        condition = ControllerStatus(CONFIG, faults=[], reading=ControllerReading(clock.now_ns(), {"x": at_rest}))
        condition.referenced["x"] = True
        driver = Slow(clock)
        jogging = JogControl(
            cast(Driver, driver),
            clock,
            condition,
            cast(BackgroundTasks, SimpleNamespace(spawn=asyncio.ensure_future)),
            PollTimer(clock),
        )
        velocities = {"x": 0.2}
        await jogging.apply_request(
            JogRequest(request_id="r", actor="a", holder="h", seq=1, velocities=velocities, valid_ms=200)
        )
        await sleep_ns(clock, 1)
        reading = replace(at_rest, enabled=enabled)
        jogging.handle_reading(ControllerReading(clock.now_ns() + NS_PER_S, {"x": reading}))
        await sleep_ns(clock, 1)
        assert driver.ordered == ["x", "stop x"]
        assert condition.stop_unseen and not condition.jogging

    run_virtual(main)


def test_heartbeats_continue_until_t0_and_not_beyond_it_without_a_poll() -> None:
    """A member that was released counts as dead after 0.7 s of silence, and its line may be reserved until T0."""
    t0_ns = 3 * NS_PER_S

    async def main(clock: VirtualClock) -> list[int]:
        beats: list[int] = []

        def publish() -> None:
            beats.append(clock.now_ns())
            presenter.published_ns = clock.now_ns()

        presenter = SimpleNamespace(published_ns=0, current_mode=lambda: "moving", publish_state=publish)
        unit = SimpleNamespace(
            _clock=clock,
            _parts=SimpleNamespace(
                publisher=presenter,
                steps=SimpleNamespace(present=SimpleNamespace(t0_host_ns=clock.now_ns() + t0_ns)),
            ),
        )
        began_ns = presenter.published_ns = clock.now_ns()
        beating = asyncio.ensure_future(ControllerSupervisor._publish_heartbeats(cast(ControllerSupervisor, unit)))
        await sleep_ns(clock, 2 * t0_ns)
        beating.cancel()
        return [at_ns - began_ns for at_ns in (began_ns, *beats)]

    beats = run_virtual(main)
    assert max(b - a for a, b in zip(beats, [*beats[1:], t0_ns], strict=True)) < 0.5 * NS_PER_S
    assert beats[-1] < t0_ns


@pytest.mark.parametrize(
    ("read_ns", "moving", "member", "pending"),
    [
        (900, False, "", True),
        (1001, True, "", True),
        (1001, False, "followed_steps", True),
        (1001, False, "loading_lock", True),
        (1001, False, "stop_pending", True),
        (1001, False, "", False),
    ],
)
def test_a_stop_is_pending_when_the_link_breaks_before_its_effect_is_observed(
    read_ns: int, moving: bool, member: str, pending: bool
) -> None:
    """Its command may have been lost with the link; it may be moving until a poll observes it."""
    reading = ControllerReading(read_ns, {"x": AxisReading(0, 0.0, 0.0, moving, enabled=True)})
    condition = ControllerStatus(CONFIG, reading=reading, stopped_ns=STOPPED_NS, may_move=False)
    steps = loaded_steps()
    if member == "loading_lock":
        steps.loading_lock = cast(asyncio.Lock, SimpleNamespace(locked=lambda: True))
    elif member:
        setattr(steps, member, True)
    unit = SimpleNamespace(
        controller="c",
        _pauses=SimpleNamespace(note_lost=lambda: None),
        _log=SimpleNamespace(warning=nothing),
        _parts=SimpleNamespace(
            status=condition,
            steps=steps,
            withdrawal=SimpleNamespace(drop_step=nothing),
            jogging=SimpleNamespace(drop_all=nothing),
            polling=SimpleNamespace(is_connected=True),
            publisher=SimpleNamespace(emit_event=nothing, publish_state=lambda: None),
            pending_stop=SimpleNamespace(request_stop=lambda: requested.append(True)),
        ),
    )
    requested: list[bool] = []
    ControllerSupervisor._handle_offline(cast(ControllerSupervisor, unit), STARTING)
    assert bool(requested) is pending
    assert condition.may_move is pending


def test_a_pending_stop_is_repeated_until_the_controller_answers() -> None:
    """Bytes that are written into a line that is still broken are lost."""
    told: list[str] = []

    class Broken:
        async def stop_before_connect(self) -> bool:
            told.append("stop")
            return True

        async def stop(self, abort: bool) -> None:
            assert not abort
            told.append("stop again")

        async def connect(self) -> None:
            told.append("connect")
            if told.count("connect") < 3:
                raise ControllerFault("no-answer", "nothing came", "")

        async def configure(self) -> None:
            return None

    async def load_soft_limits(_: object) -> None:
        return None

    async def main(clock: VirtualClock) -> None:
        driver: Any = Broken()
        pending = PendingStop(cast(ControllerContext, SimpleNamespace(driver=driver)), loaded_steps())
        pending.request_stop()
        unit: Any = SimpleNamespace(
            _context=SimpleNamespace(driver=driver, config=CONFIG),
            _parts=SimpleNamespace(
                pending_stop=pending,
                defects=SimpleNamespace(),
                status=ControllerStatus(CONFIG),
                referencing=SimpleNamespace(load_soft_limits=load_soft_limits),
                publisher=SimpleNamespace(emit_event=lambda kind, _: told.append(kind)),
            ),
        )
        for _attempt in range(2):
            with pytest.raises(ControllerFault):
                await ControllerSupervisor._set_up_connection(cast(ControllerSupervisor, unit))
            assert pending.is_pending
        for _attempt in range(2):
            await ControllerSupervisor._set_up_connection(cast(ControllerSupervisor, unit))
            assert not pending.is_pending

    run_virtual(main)
    assert told == [*["stop", "connect"] * 3, "stop again", "stopped", "connect"]


@pytest.mark.parametrize("lost_ms", [0, 50])
def test_a_controller_that_answers_while_it_is_being_connected_is_not_online_yet(lost_ms: int) -> None:
    """A command may reach a controller that answers already, whose program is still being checked; or its poll waits
    for its turn on a line that is lost and reconnected meanwhile."""
    taken: list[int] = []

    async def main(clock: VirtualClock) -> None:
        async def poll() -> ControllerReading:
            await sleep_ns(clock, 100 * NS_PER_MS)
            return ControllerReading(clock.now_ns(), {})

        unit = SimpleNamespace(
            _context=SimpleNamespace(driver=SimpleNamespace(poll=poll), clock=clock),
            _steps=SimpleNamespace(),
            is_connected=lost_ms > 0,
            listener=SimpleNamespace(handle_reading=lambda reading: taken.append(reading.at_ns)),
            _publisher=SimpleNamespace(publish_state=nothing),
        )
        refreshing = asyncio.ensure_future(StatePolling.poll_and_publish(cast(StatePolling, unit)))
        await sleep_ns(clock, lost_ms * NS_PER_MS)
        unit.is_connected = False
        with pytest.raises(LinkClosed, match="not connected yet"):
            await refreshing
        unit.is_connected = True
        await StatePolling.poll_and_publish(cast(StatePolling, unit))

    run_virtual(main)
    assert len(taken) == 1


@pytest.mark.parametrize(("by_hand", "until_ns"), [("", 7), ("jogging", None), ("homing", None)])
def test_a_jogged_controller_is_polled_whatever_else_is_requested_of_it(by_hand: str, until_ns: int | None) -> None:
    condition = ControllerStatus(CONFIG, faults=[])
    if by_hand:
        getattr(condition, by_hand).add("x")
    unit = SimpleNamespace(
        _status=condition,
        _steps=SimpleNamespace(quiet_until_ns=lambda _: 7),
        _context=SimpleNamespace(clock=SimpleNamespace(now_ns=lambda: 0)),
        _pairs=SimpleNamespace(has_pairs=False),
    )
    assert StatePolling._quiet_until_ns(cast(StatePolling, unit)) == until_ns
