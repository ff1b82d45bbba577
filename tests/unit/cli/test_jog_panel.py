"""The jog panel's logic in virtual time: keys and answers in, requests out."""

from unit.controller_states import make_controller_state

from orchestrator.cli.manual.jog.held_key import REPEAT_WAIT_NS, SILENCE_NS, TAP_NS
from orchestrator.cli.manual.jog.keys import FocusChange, KeyEvent
from orchestrator.cli.manual.jog.panel import (
    IDLE_NS,
    RENEW_NS,
    AcquireAxis,
    ExitPanel,
    JogAxis,
    JogPanel,
    PanelAction,
    ReleaseAxis,
    RequestFleetEstop,
    RequestFleetStop,
    StopJog,
)
from orchestrator.cli.manual.jog.work import CONFIRM_NS, CancelWork, RunWork
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.report import LeaseState
from orchestrator.model.state import AxisState, ControllerState

LEFT, RIGHT, UP, DOWN = KeyEvent("left"), KeyEvent("right"), KeyEvent("up"), KeyEvent("down")
HOLDER = "manual-1"


def axis(**more: object) -> Axis:
    fields = {"motors": ["X"], "unit": "mm", "scale": 1000, "limits": {"velocity": 200, "acceleration": 1000}}
    return Axis.model_validate({**fields, **more})


def state(controller: str = "gantry", referenced: bool = True, leases: dict[str, str] | None = None) -> ControllerState:
    now = AxisState(
        position=12.0,
        commanded=12.0,
        velocity=0.0,
        motor_position=12.0,
        raw_counts=12000.0,
        commanded_counts=12000,
        unit="mm",
        moving=False,
        enabled=True,
        referenced=referenced,
    )
    return make_controller_state(controller, {"x": now, "y": now}, leases=leases)


class Desk:
    """A panel with a clock, and a fleet that grants everything until `refuse` is set."""

    def __init__(self, releases: bool = True) -> None:
        axes = {"gantry.x": axis(), "gantry.y": axis(), "stage.x": axis()}
        self.panel = JogPanel(axes, releases, "lab")
        self.now_ns = NS_PER_S
        self.done: list[PanelAction] = []
        self.refuse: Refusal | None = None
        self.answers = True
        for controller in ("gantry", "stage"):
            self.panel.store_state(state(controller), self.now_ns)

    def key(self, *keys: KeyEvent) -> list[PanelAction]:
        return self._do(*(lambda key=key: self.panel.handle_key(key, self.now_ns) for key in keys))

    def wait(self, ns: int) -> list[PanelAction]:
        """Let time pass, with every tick that the panel requests."""
        done: list[PanelAction] = []
        end_ns = self.now_ns + ns
        while (due_ns := self.panel.next_tick_ns()) is not None and due_ns <= end_ns:
            self.now_ns = max(self.now_ns, due_ns)
            done += self._do(lambda: self.panel.handle_time(self.now_ns))
        self.now_ns = end_ns
        return done

    def _do(self, *calls: object) -> list[PanelAction]:
        done: list[PanelAction] = []
        for call in calls:
            actions = call()  # type: ignore[operator]
            while actions:
                action = actions.pop(0)
                done.append(action)
                if self.answers:
                    actions += self._answer(action)
        self.done += done
        return done

    def _answer(self, action: PanelAction) -> list[PanelAction]:
        if isinstance(action, AcquireAxis):
            if self.refuse is not None:
                self.panel.handle_acquire_refused(self.refuse)
                return []
            return self.panel.handle_acquired([action.axis], HOLDER, self.now_ns)
        if isinstance(action, JogAxis):
            return self.panel.handle_jog_reply(action, self.refuse, self.now_ns)
        return []


def jogs(actions: list[PanelAction]) -> list[tuple[str, float, bool]]:
    return [(each.axis, each.velocity, each.renew) for each in actions if isinstance(each, JogAxis)]


def test_a_press_acquires_the_axis_and_jogs_it_until_its_release() -> None:
    desk = Desk()
    began = desk.key(RIGHT)
    assert began[0] == AcquireAxis("gantry.x")
    assert jogs(began) == [("gantry.x", 10.0, False)]
    held = desk.wait(NS_PER_S // 2)
    assert len(held) == NS_PER_S // 2 // RENEW_NS
    assert set(jogs(held)) == {("gantry.x", 10.0, True)}
    assert desk.panel.jog_direction == 1
    assert desk.key(KeyEvent("right", "release")) == [StopJog()]
    assert desk.wait(IDLE_NS - 1) == []
    assert desk.key(LEFT) == [JogAxis("gantry.x", -10.0, False, 2)]


def test_the_lease_is_released_after_an_idle_time() -> None:
    desk = Desk()
    desk.key(RIGHT, KeyEvent("right", "release"))
    assert desk.panel.is_acquired
    assert desk.wait(IDLE_NS) == [ReleaseAxis()]
    assert not desk.panel.is_acquired
    assert desk.key(RIGHT)[0] == AcquireAxis("gantry.x")


def test_a_key_released_before_the_lease_arrives_moves_nothing() -> None:
    desk = Desk()
    desk.answers = False
    assert desk.key(RIGHT) == [AcquireAxis("gantry.x")]
    assert desk.key(KeyEvent("right", "release")) == []
    assert desk.panel.handle_acquired(["gantry.x"], HOLDER, desk.now_ns) == []


def test_a_late_answer_to_an_earlier_press_changes_nothing() -> None:
    desk = Desk()
    desk.key(RIGHT)
    late = JogAxis("gantry.x", 10.0, True, 1)
    desk.key(KeyEvent("right", "release"), RIGHT)
    assert desk.panel.handle_jog_reply(late, Refusal("out-of-order", "late", ""), desk.now_ns) == []
    assert desk.panel.jog_direction == 1
    assert desk.panel.refusal is None


def test_a_jog_that_was_stopped_elsewhere_waits_for_a_new_key_press() -> None:
    desk = Desk()
    desk.key(RIGHT)
    desk.refuse = Refusal("not-jogging", "gantry.x was stopped by ann", "press again")
    assert desk.wait(RENEW_NS)[-1] == StopJog()
    assert desk.panel.refusal == desk.refuse
    desk.refuse = None
    assert desk.key(KeyEvent("right", "repeat"), KeyEvent("right", "repeat"), KeyEvent("right", "release")) == []
    assert jogs(desk.key(RIGHT)) == [("gantry.x", 10.0, False)]
    assert desk.panel.refusal is None


def test_the_same_on_a_terminal_that_only_repeats() -> None:
    desk = Desk(releases=False)
    desk.key(RIGHT)
    desk.refuse = Refusal("not-jogging", "stopped", "")
    desk.wait(RENEW_NS)
    desk.refuse = None
    desk.wait(440 * NS_PER_MS)
    for _ in range(30):
        assert desk.key(RIGHT) == []
        assert desk.wait(33 * NS_PER_MS) == []
    desk.wait(NS_PER_S)
    assert jogs(desk.key(RIGHT)) == [("gantry.x", 10.0, False)]


def test_a_tap_moves_for_the_validity_of_a_jog_and_repeats_continue_it() -> None:
    desk = Desk(releases=False)
    desk.key(RIGHT)
    tapped = desk.wait(500 * NS_PER_MS)
    assert tapped[-1] == StopJog()
    assert len(tapped) - 1 == TAP_NS // RENEW_NS
    assert jogs(desk.key(RIGHT)) == [("gantry.x", 10.0, False)]
    for _ in range(30):
        assert StopJog() not in desk.wait(33 * NS_PER_MS)
        assert desk.key(RIGHT) == []
    began_ns = desk.now_ns
    assert StopJog() not in desk.wait(REPEAT_WAIT_NS - 1)
    assert desk.wait(1) == [StopJog()]
    assert desk.now_ns - began_ns == REPEAT_WAIT_NS


def test_a_silent_terminal_stops() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert desk.wait(SILENCE_NS)[-1] == StopJog()
    assert "press it again" in desk.panel.note


def test_a_window_without_the_keyboard_stops() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert desk.panel.handle_focus(FocusChange(False), desk.now_ns) == [StopJog()]
    assert "lost the keyboard" in desk.panel.note
    assert desk.key(KeyEvent("right", "repeat")) == []


def test_a_refused_lease_is_shown_and_not_requested_again_by_a_held_key() -> None:
    desk = Desk()
    desk.refuse = Refusal("leased", "gantry.x is held by ann", "wait")
    assert desk.key(RIGHT) == [AcquireAxis("gantry.x")]
    assert desk.key(KeyEvent("right", "repeat")) == []
    assert desk.panel.refusal == desk.refuse
    assert desk.key(KeyEvent("right", "release"), RIGHT) == [AcquireAxis("gantry.x")]


def test_a_lost_lease_ends_the_motion_until_a_fresh_press() -> None:
    desk = Desk()
    desk.key(RIGHT)
    desk.panel.handle_lease_lost(Refusal("permit", "door-closed is missing", ""))
    assert desk.wait(NS_PER_S) == []
    assert desk.key(KeyEvent("right", "repeat"), KeyEvent("right", "release")) == []
    assert desk.key(RIGHT)[0] == AcquireAxis("gantry.x")


def test_speed_changes_while_it_moves() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert jogs(desk.key(KeyEvent("9"))) == [("gantry.x", 45.0, True)]
    assert jogs(desk.key(KeyEvent("-"))) == [("gantry.x", 40.0, True)]
    assert jogs(desk.key(KeyEvent("+"))) == [("gantry.x", 45.0, True)]
    for _ in range(20):
        desk.key(KeyEvent("+"))
    assert desk.panel.speed_fraction == 1.0
    for _ in range(20):
        desk.key(KeyEvent("-"))
    assert desk.panel.speed_fraction == 0.01


def test_an_unreferenced_axis_is_jogged_slowly() -> None:
    desk = Desk()
    desk.panel.store_state(state(referenced=False), desk.now_ns)
    desk.key(KeyEvent("5"))
    assert jogs(desk.key(RIGHT)) == [("gantry.x", 2.0, False)]


def test_another_axis_stops_the_first_and_needs_its_own_lease() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert desk.key(DOWN) == [StopJog()]
    assert desk.key(KeyEvent("right", "repeat")) == []
    assert desk.panel.chosen_axis == "gantry.y"
    assert desk.key(RIGHT)[:2] == [ReleaseAxis(), AcquireAxis("gantry.y")]
    desk.key(UP, UP)
    assert desk.panel.chosen_axis == "stage.x"


def test_an_axis_leased_with_another_needs_no_lease_of_its_own() -> None:
    desk = Desk()
    desk.answers = False
    desk.key(RIGHT)
    desk.panel.handle_acquired(["gantry.x", "gantry.y"], HOLDER, desk.now_ns)
    desk.answers = True
    desk.key(DOWN)
    assert desk.key(RIGHT) == [JogAxis("gantry.y", 10.0, False, 2)]


def test_an_axis_selected_while_the_lease_is_pending() -> None:
    desk = Desk()
    desk.answers = False
    assert desk.key(RIGHT, DOWN, RIGHT) == [AcquireAxis("gantry.x")]
    assert desk.panel.handle_acquired(["gantry.x"], HOLDER, desk.now_ns) == [ReleaseAxis(), AcquireAxis("gantry.y")]
    assert jogs(desk.panel.handle_acquired(["gantry.y"], HOLDER, desk.now_ns)) == [("gantry.y", 10.0, False)]


def test_the_other_direction_stops_first() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert desk.key(LEFT) == [StopJog(), JogAxis("gantry.x", -10.0, False, 2)]
    assert desk.key(KeyEvent("right", "release")) == []
    assert desk.key(KeyEvent("left", "release")) == [StopJog()]


def test_stops_and_ways_out() -> None:
    desk = Desk()
    for key, actions in (
        ("space", [StopJog()]),
        ("s", [StopJog(), RequestFleetStop()]),
        ("escape", [StopJog()]),
        ("x", [RequestFleetEstop(), StopJog()]),
        ("X", [RequestFleetEstop(), StopJog()]),
        ("q", [StopJog(), ExitPanel(0)]),
        ("ctrl+c", [StopJog(), ExitPanel(130)]),
        ("ctrl+z", [StopJog()]),
    ):
        desk.key(RIGHT)
        assert desk.key(KeyEvent(key)) == actions
        assert desk.key(KeyEvent("right", "repeat"), KeyEvent(key, "repeat"), KeyEvent(key, "release")) == []
    assert "background" in desk.panel.note


def test_one_renewal_at_a_time() -> None:
    desk = Desk()
    desk.key(RIGHT)
    desk.answers = False
    assert len(desk.wait(NS_PER_S // 2)) == 1


def test_the_owner_of_an_axis_is_shown() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert desk.panel.describe_holder("gantry.x") == "you"
    desk.panel.store_state(state(leases={"x": HOLDER, "y": "manual-2"}), desk.now_ns)
    assert desk.panel.describe_holder("gantry.y") == "manual-2"
    desk.panel.store_lease(
        LeaseState(controller="gantry", axis="y", holder="manual-2", actor="ann", what="jog panel", epoch=1)
    )
    assert desk.panel.describe_holder("gantry.y") == "ann (jog panel)"
    assert desk.panel.describe_holder("stage.x") == ""


# The keys beside the speed keys 1 to 9, + and - on common keyboards, with Shift or without.
BESIDE_SPEED_KEYS = set("`~!@#$%^&*()qwertyuiop[]{}=_") | {"backspace", "enter"}


def keys_for(action: type) -> set[str]:
    """All keys that cause an action while an axis is jogged."""
    names = [chr(code) for code in range(33, 127)]
    names += ["space", "escape", "tab", "enter", "backspace", "pageup", "pagedown", "ctrl+a", "ctrl+d", "alt+x"]
    found: set[str] = set()
    for name in names:
        desk = Desk()
        desk.key(RIGHT)
        if any(isinstance(each, action) for each in desk.key(KeyEvent(name))):
            found.add(name)
    return found


def test_stop_and_estop_keys_are_those_that_the_screen_shows() -> None:
    assert keys_for(RequestFleetEstop) == {"x", "X"}
    assert keys_for(RequestFleetStop) == {"s", "S"}
    assert not keys_for(RequestFleetEstop) & BESIDE_SPEED_KEYS
    assert not keys_for(RequestFleetStop) & BESIDE_SPEED_KEYS


def sizes(desk: Desk) -> list[float | None]:
    found: list[float | None] = []
    for _ in range(5):
        found.append(desk.panel.work.step_size)
        desk.key(KeyEvent("tab"))
    return found


def test_an_arrow_makes_one_step_however_long_it_is_held() -> None:
    desk = Desk()
    assert sizes(desk) == [None, 0.01, 0.1, 1.0, 10.0]
    desk.key(KeyEvent("tab"), KeyEvent("tab"))
    step = RunWork("move gantry.x by 0.1", {"do": "move", "by": {"gantry.x": 0.1}, "speed": 0.05})
    assert desk.key(RIGHT) == [step]
    assert desk.key(KeyEvent("right", "repeat")) == [] and desk.wait(NS_PER_S // 2) == []
    desk.panel.handle_work_done(step, None)
    assert desk.key(KeyEvent("right", "repeat"), KeyEvent("right", "release")) == []
    assert desk.panel.note == "done: move gantry.x by 0.1"
    assert desk.key(LEFT)[-1].step["by"] == {"gantry.x": -0.1}  # type: ignore[union-attr]


def test_repeats_of_a_plain_terminal_make_no_further_steps() -> None:
    desk = Desk(releases=False)
    desk.key(KeyEvent("tab"))
    (step,) = desk.key(RIGHT)
    assert isinstance(step, RunWork)
    desk.panel.handle_work_done(step, None)
    for wait_ms in (500, 40, 40, 40, 40):
        desk.wait(wait_ms * NS_PER_MS)
        assert desk.key(RIGHT) == []


def test_a_jogged_axis_is_released_before_its_step() -> None:
    desk = Desk()
    desk.key(RIGHT, KeyEvent("right", "release"), KeyEvent("tab"))
    assert [type(each) for each in desk.key(RIGHT)] == [ReleaseAxis, RunWork]
    assert not desk.panel.is_acquired


def test_one_work_at_a_time_and_each_stop_key_ends_it() -> None:
    for key, actions in (
        ("space", [CancelWork()]),
        ("escape", [CancelWork()]),
        ("s", [CancelWork(), RequestFleetStop()]),
        ("x", [RequestFleetEstop(), CancelWork()]),
        ("q", [CancelWork(), ExitPanel(0)]),
        ("down", [CancelWork()]),
    ):
        desk = Desk()
        assert desk.key(KeyEvent("e")) == [RunWork("enable gantry.x", {"do": "enable", "axes": ["gantry.x"]})]
        assert desk.key(RIGHT, KeyEvent("e"), KeyEvent("h"), KeyEvent("z"), KeyEvent("tab")) == []
        assert "not while it works: enable gantry.x" in desk.panel.note
        assert desk.key(KeyEvent(key)) == actions
    desk = Desk()
    desk.key(KeyEvent("e"))
    assert desk._do(lambda: desk.panel.handle_focus(FocusChange(False), desk.now_ns)) == [CancelWork()]


def test_home_and_zero_need_a_second_press() -> None:
    for key, step in (
        ("h", {"do": "home", "axes": ["gantry.x"]}),
        ("z", {"do": "set-position", "axes": {"gantry.x": 0}}),
    ):
        desk = Desk()
        assert desk.key(KeyEvent(key)) == []
        assert f"press {key} again" in desk.panel.note
        (work,) = desk.key(KeyEvent(key))
        assert isinstance(work, RunWork) and work.step == step
        desk.panel.handle_work_done(work, Refusal("estop-latched", "e-stop by ann", "reset it"))
        assert desk.panel.refusal is not None and not desk.panel.note
        desk.key(KeyEvent(key))
        desk.now_ns += CONFIRM_NS
        assert desk.key(KeyEvent(key)) == []
        assert desk.key(DOWN, KeyEvent(key)) == []
