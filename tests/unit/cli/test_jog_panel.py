"""The jog panel's logic in virtual time: keys and answers in, requests out."""

from orchestrator.cli.jog.held_key import SILENT_NS, TAP_NS, WAIT_NS
from orchestrator.cli.jog.keys import Focus, Key
from orchestrator.cli.jog.panel import (
    IDLE_NS,
    RENEW_NS,
    Action,
    EstopFleet,
    GiveBack,
    Halt,
    Jog,
    JogPanel,
    Leave,
    StopFleet,
    TakeAxis,
)
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.fleet import Axis
from orchestrator.model.messages import RefusalDetails
from orchestrator.model.report import LeaseState
from orchestrator.model.state import AxisState, ControllerState

LEFT, RIGHT, UP, DOWN = Key("left"), Key("right"), Key("up"), Key("down")
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
    return ControllerState(
        controller=controller,
        instance="i",
        seq=1,
        utc="",
        fleet_ns=None,
        mode="idle",
        axes={"x": now, "y": now},
        inputs={},
        outputs={},
        faults=[],
        clock=None,
        estop=None,
        epoch=1,
        digest="d",
        leases=leases or {},
    )


class Desk:
    """A panel with a clock, and a fleet that grants everything until `refuse` says no."""

    def __init__(self, releases: bool = True) -> None:
        axes = {"gantry.x": axis(), "gantry.y": axis(), "stage.x": axis()}
        self.panel = JogPanel(axes, releases, "lab")
        self.now_ns = NS_PER_S
        self.done: list[Action] = []
        self.refuse: RefusalDetails | None = None
        self.answers = True
        for controller in ("gantry", "stage"):
            self.panel.hear(state(controller), self.now_ns)

    def key(self, *keys: Key) -> list[Action]:
        return self._do(*(lambda key=key: self.panel.key(key, self.now_ns) for key in keys))

    def wait(self, ns: int) -> list[Action]:
        """Let time pass, with every tick that the panel asks for."""
        done: list[Action] = []
        end_ns = self.now_ns + ns
        while (due_ns := self.panel.due_ns()) is not None and due_ns <= end_ns:
            self.now_ns = max(self.now_ns, due_ns)
            done += self._do(lambda: self.panel.tick(self.now_ns))
        self.now_ns = end_ns
        return done

    def _do(self, *calls: object) -> list[Action]:
        done: list[Action] = []
        for call in calls:
            actions = call()  # type: ignore[operator]
            while actions:
                action = actions.pop(0)
                done.append(action)
                if self.answers:
                    actions += self._answer(action)
        self.done += done
        return done

    def _answer(self, action: Action) -> list[Action]:
        if isinstance(action, TakeAxis):
            if self.refuse is not None:
                self.panel.not_taken(self.refuse)
                return []
            return self.panel.taken([action.axis], HOLDER, self.now_ns)
        if isinstance(action, Jog):
            return self.panel.answered(action, self.refuse, self.now_ns)
        return []


def jogs(actions: list[Action]) -> list[tuple[str, float, bool]]:
    return [(each.axis, each.velocity, each.renew) for each in actions if isinstance(each, Jog)]


def test_a_press_takes_the_axis_and_jogs_it_until_it_is_let_go() -> None:
    desk = Desk()
    began = desk.key(RIGHT)
    assert began[0] == TakeAxis("gantry.x")
    assert jogs(began) == [("gantry.x", 10.0, False)]
    held = desk.wait(NS_PER_S // 2)
    assert len(held) == NS_PER_S // 2 // RENEW_NS
    assert set(jogs(held)) == {("gantry.x", 10.0, True)}
    assert desk.panel.direction == 1
    assert desk.key(Key("right", "release")) == [Halt()]
    assert desk.wait(IDLE_NS - 1) == []
    assert desk.key(LEFT) == [Jog("gantry.x", -10.0, False, 2)]


def test_the_axis_is_given_back_after_some_rest() -> None:
    desk = Desk()
    desk.key(RIGHT, Key("right", "release"))
    assert desk.panel.leased
    assert desk.wait(IDLE_NS) == [GiveBack()]
    assert not desk.panel.leased
    assert desk.key(RIGHT)[0] == TakeAxis("gantry.x")


def test_let_go_before_the_lease_is_there_nothing_moves() -> None:
    desk = Desk()
    desk.answers = False
    assert desk.key(RIGHT) == [TakeAxis("gantry.x")]
    assert desk.key(Key("right", "release")) == []
    assert desk.panel.taken(["gantry.x"], HOLDER, desk.now_ns) == []


def test_a_late_answer_to_an_earlier_press_changes_nothing() -> None:
    desk = Desk()
    desk.key(RIGHT)
    late = Jog("gantry.x", 10.0, True, 1)
    desk.key(Key("right", "release"), RIGHT)
    assert desk.panel.answered(late, RefusalDetails(code="out-of-order", text="late"), desk.now_ns) == []
    assert desk.panel.direction == 1
    assert desk.panel.refusal is None


def test_what_somebody_stopped_waits_for_a_key_pressed_anew() -> None:
    desk = Desk()
    desk.key(RIGHT)
    desk.refuse = RefusalDetails(code="not-jogging", text="gantry.x was stopped by ann", remedy="press again")
    assert desk.wait(RENEW_NS)[-1] == Halt()
    assert desk.panel.refusal == desk.refuse
    desk.refuse = None
    assert desk.key(Key("right", "repeat"), Key("right", "repeat"), Key("right", "release")) == []
    assert jogs(desk.key(RIGHT)) == [("gantry.x", 10.0, False)]
    assert desk.panel.refusal is None


def test_the_same_on_a_terminal_that_only_repeats() -> None:
    desk = Desk(releases=False)
    desk.key(RIGHT)
    desk.refuse = RefusalDetails(code="not-jogging", text="stopped")
    desk.wait(RENEW_NS)
    desk.refuse = None
    desk.wait(440 * NS_PER_MS)
    for _ in range(30):
        assert desk.key(RIGHT) == []
        assert desk.wait(33 * NS_PER_MS) == []
    desk.wait(NS_PER_S)
    assert jogs(desk.key(RIGHT)) == [("gantry.x", 10.0, False)]


def test_a_tap_moves_for_as_long_as_a_jog_is_good_for_and_repeats_go_on() -> None:
    desk = Desk(releases=False)
    desk.key(RIGHT)
    tapped = desk.wait(500 * NS_PER_MS)
    assert tapped[-1] == Halt()
    assert len(tapped) - 1 == TAP_NS // RENEW_NS
    assert jogs(desk.key(RIGHT)) == [("gantry.x", 10.0, False)]
    for _ in range(30):
        assert Halt() not in desk.wait(33 * NS_PER_MS)
        assert desk.key(RIGHT) == []
    began_ns = desk.now_ns
    assert Halt() not in desk.wait(WAIT_NS - 1)
    assert desk.wait(1) == [Halt()]
    assert desk.now_ns - began_ns == WAIT_NS


def test_a_silent_terminal_stops() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert desk.wait(SILENT_NS)[-1] == Halt()
    assert "press it again" in desk.panel.note


def test_a_window_without_the_keyboard_stops() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert desk.panel.focus(Focus(False), desk.now_ns) == [Halt()]
    assert "lost the keyboard" in desk.panel.note
    assert desk.key(Key("right", "repeat")) == []


def test_a_refused_lease_is_shown_and_not_asked_for_again_by_a_held_key() -> None:
    desk = Desk()
    desk.refuse = RefusalDetails(code="leased", text="gantry.x is held by ann", remedy="wait")
    assert desk.key(RIGHT) == [TakeAxis("gantry.x")]
    assert desk.key(Key("right", "repeat")) == []
    assert desk.panel.refusal == desk.refuse
    assert desk.key(Key("right", "release"), RIGHT) == [TakeAxis("gantry.x")]


def test_a_lost_lease_ends_the_motion_until_a_fresh_press() -> None:
    desk = Desk()
    desk.key(RIGHT)
    desk.panel.lost(RefusalDetails(code="permit", text="door-closed is missing"))
    assert desk.wait(NS_PER_S) == []
    assert desk.key(Key("right", "repeat"), Key("right", "release")) == []
    assert desk.key(RIGHT)[0] == TakeAxis("gantry.x")


def test_speed_changes_while_it_moves() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert jogs(desk.key(Key("9"))) == [("gantry.x", 45.0, True)]
    assert jogs(desk.key(Key("-"))) == [("gantry.x", 40.0, True)]
    assert jogs(desk.key(Key("+"))) == [("gantry.x", 45.0, True)]
    for _ in range(20):
        desk.key(Key("+"))
    assert desk.panel.fraction == 1.0
    for _ in range(20):
        desk.key(Key("-"))
    assert desk.panel.fraction == 0.01


def test_an_unreferenced_axis_is_jogged_slowly() -> None:
    desk = Desk()
    desk.panel.hear(state(referenced=False), desk.now_ns)
    desk.key(Key("5"))
    assert jogs(desk.key(RIGHT)) == [("gantry.x", 2.0, False)]


def test_another_axis_stops_the_first_and_needs_its_own_lease() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert desk.key(DOWN) == [Halt()]
    assert desk.key(Key("right", "repeat")) == []
    assert desk.panel.axis == "gantry.y"
    assert desk.key(RIGHT)[:2] == [GiveBack(), TakeAxis("gantry.y")]
    desk.key(UP, UP)
    assert desk.panel.axis == "stage.x"


def test_an_axis_that_came_with_another_needs_no_lease_of_its_own() -> None:
    desk = Desk()
    desk.answers = False
    desk.key(RIGHT)
    desk.panel.taken(["gantry.x", "gantry.y"], HOLDER, desk.now_ns)
    desk.answers = True
    desk.key(DOWN)
    assert desk.key(RIGHT) == [Jog("gantry.y", 10.0, False, 2)]


def test_an_axis_chosen_while_the_lease_is_on_its_way() -> None:
    desk = Desk()
    desk.answers = False
    assert desk.key(RIGHT, DOWN, RIGHT) == [TakeAxis("gantry.x")]
    assert desk.panel.taken(["gantry.x"], HOLDER, desk.now_ns) == [GiveBack(), TakeAxis("gantry.y")]
    assert jogs(desk.panel.taken(["gantry.y"], HOLDER, desk.now_ns)) == [("gantry.y", 10.0, False)]


def test_the_other_direction_stops_first() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert desk.key(LEFT) == [Halt(), Jog("gantry.x", -10.0, False, 2)]
    assert desk.key(Key("right", "release")) == []
    assert desk.key(Key("left", "release")) == [Halt()]


def test_stops_and_ways_out() -> None:
    desk = Desk()
    for key, actions in (
        ("space", [Halt()]),
        ("s", [Halt(), StopFleet()]),
        ("!", [EstopFleet(), Halt()]),
        ("q", [Halt(), Leave(0)]),
        ("ctrl+c", [Halt(), Leave(130)]),
        ("ctrl+z", [Halt()]),
    ):
        desk.key(RIGHT)
        assert desk.key(Key(key)) == actions
        assert desk.key(Key("right", "repeat"), Key(key, "repeat"), Key(key, "release")) == []
    assert "background" in desk.panel.note


def test_one_renewal_at_a_time() -> None:
    desk = Desk()
    desk.key(RIGHT)
    desk.answers = False
    assert len(desk.wait(NS_PER_S // 2)) == 1


def test_who_holds_an_axis() -> None:
    desk = Desk()
    desk.key(RIGHT)
    assert desk.panel.held_by("gantry.x") == "you"
    desk.panel.hear(state(leases={"x": HOLDER, "y": "manual-2"}), desk.now_ns)
    assert desk.panel.held_by("gantry.y") == "manual-2"
    desk.panel.hear_lease(
        LeaseState(controller="gantry", axis="y", holder="manual-2", actor="ann", what="jog panel", epoch=1)
    )
    assert desk.panel.held_by("gantry.y") == "ann (jog panel)"
    assert desk.panel.held_by("stage.x") == ""
