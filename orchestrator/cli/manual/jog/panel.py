"""The logic of the jog panel, without a terminal and without a bus: keys, time and replies in, requests out.

The session performs the actions that the methods return, in order, and reports their results to the panel.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from orchestrator.cli.base.codes import INTERRUPTED
from orchestrator.cli.manual.jog.held_key import HeldKey, KeyChange
from orchestrator.cli.manual.jog.keys import FocusChange, KeyEvent
from orchestrator.cli.manual.jog.work import AxisWork, CancelWork, RunWork
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Axis
from orchestrator.model.report import LeaseState
from orchestrator.model.state import AxisState, ControllerState

# A jog is valid for 200 ms: two renewals may be lost or late before the axis stops.
RENEW_NS = 60 * NS_PER_MS
IDLE_NS = 3 * NS_PER_S  # without motion, until the lease of the axis is released

FRACTIONS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
FIRST_FRACTION = 0.2

_DIRECTIONS = {"left": -1, "right": 1}


@dataclass(frozen=True, slots=True)
class AcquireAxis:
    """Acquire the lease of an axis; then `handle_acquired` or `handle_acquire_refused`."""

    axis: str


@dataclass(frozen=True, slots=True)
class ReleaseAxis:
    """Release the lease, after all earlier requests."""


@dataclass(frozen=True, slots=True)
class JogAxis:
    """Jog at `velocity` (unit/s); then `handle_jog_reply`. press: number of the key press that it belongs to."""

    axis: str
    velocity: float
    renew: bool
    press: int


@dataclass(frozen=True, slots=True)
class StopJog:
    """Stop the jogged axis immediately, whatever replies are still missing."""


@dataclass(frozen=True, slots=True)
class RequestFleetStop:
    """Like `tutti stop`."""


@dataclass(frozen=True, slots=True)
class RequestFleetEstop:
    """Like `tutti estop`."""


@dataclass(frozen=True, slots=True)
class ExitPanel:
    """Exit with this code; the motion is stopped and the lease released."""

    code: int


PanelAction = (
    AcquireAxis
    | ReleaseAxis
    | JogAxis
    | StopJog
    | RunWork
    | CancelWork
    | RequestFleetStop
    | RequestFleetEstop
    | ExitPanel
)


@dataclass(slots=True)
class _KeyMotion:
    """The motion of one key press."""

    number: int
    axis: str
    direction: int
    asked: bool = False
    begun: bool = False
    waiting: bool = False  # for the reply to a renewal
    renew_ns: int = 0
    velocity: float = 0.0


@dataclass(slots=True)
class JogPanel:
    """The panel. Instants on one clock, ns.

    axes: the shown ones, `controller.axis`, with their configurations.
    refusal: the last one, shown until the next press.
    note: any other message, shown until the next press.
    """

    axes: Mapping[str, Axis]
    releases: bool
    fleet: str = ""
    chosen: int = 0
    states: dict[str, ControllerState] = field(default_factory=dict[str, ControllerState])
    seen_ns: dict[str, int] = field(default_factory=dict[str, int])
    leases: dict[str, LeaseState] = field(default_factory=dict[str, LeaseState])
    refusal: Refusal | None = None
    note: str = ""
    holder: str | None = None
    work: AxisWork = field(default_factory=AxisWork)
    _acquired: frozenset[str] = frozenset()
    _acquiring: bool = False
    _step: int = FRACTIONS.index(FIRST_FRACTION)
    _motion: _KeyMotion | None = None
    _presses: int = 0
    _blocked: bool = False
    _idle_since_ns: int = 0
    _held_key: HeldKey = field(init=False)

    def __post_init__(self) -> None:
        self._held_key = HeldKey(releases=self.releases)

    # Displayed values

    @property
    def chosen_axis(self) -> str:
        """The chosen axis."""
        return list(self.axes)[self.chosen]

    @property
    def speed_fraction(self) -> float:
        """The speed as a fraction of the axis's jog speed."""
        return FRACTIONS[self._step]

    @property
    def jog_direction(self) -> int:
        """-1, 0 or 1: the direction in which the held key moves the chosen axis."""
        return self._motion.direction if self._motion else 0

    @property
    def is_acquired(self) -> bool:
        """Whether the lease of the chosen axis is acquired."""
        return self.chosen_axis in self._acquired

    def axis_state(self, axis: str) -> AxisState | None:
        """Return the known state of an axis; None without one."""
        controller, _, name = axis.partition(".")
        state = self.states.get(controller)
        return None if state is None or state.mode == "offline" else state.axes.get(name)

    def jog_speed(self, axis: str) -> float:
        """Return the largest permitted jog speed of the axis now, unit/s."""
        state_now = self.axis_state(axis)
        return self.axes[axis].jog_speed(referenced=state_now is not None and state_now.referenced)

    def key_speed(self) -> float:
        """The speed of a key press now, unit/s."""
        return self.speed_fraction * self.jog_speed(self.chosen_axis)

    def describe_holder(self, axis: str) -> str:
        """Describe the holder of an axis: "", "you", or another user or job."""
        controller, _, name = axis.partition(".")
        state = self.states.get(controller)
        holder = state.leases.get(name) if state else None
        if axis in self._acquired or (holder is not None and holder == self.holder):
            return "you"
        if holder is None:
            return ""
        lease = self.leases.get(f"{controller}/{name}") or self.leases.get(controller)
        if lease is None or lease.holder != holder:
            return holder
        return f"{lease.actor} ({lease.what})" if lease.what else lease.actor

    # Received states

    def store_state(self, state: ControllerState, now_ns: int) -> None:
        """Store a controller's state."""
        self.states[state.controller], self.seen_ns[state.controller] = state, now_ns

    def store_lease(self, lease: LeaseState) -> None:
        """Store a change of a lease."""
        self.leases[f"{lease.controller}/{lease.axis}" if lease.axis else lease.controller] = lease

    # Keys and time

    def handle_key(self, key: KeyEvent, now_ns: int) -> list[PanelAction]:
        """Handle a key event."""
        if key.name in _DIRECTIONS:
            return self._handle_change(self._held_key.handle_key(key, now_ns), now_ns)
        self._held_key.note_activity(now_ns)
        if key.kind == "release":
            return []
        # Letters are keys: Shift and Caps Lock do not matter.
        bound = self._key_bindings().get(key.name.lower())
        if bound is None or (key.kind == "repeat" and key.name not in ("+", "=", "-", "up", "down")):
            return []
        return bound(now_ns)

    def handle_focus(self, focus: FocusChange, now_ns: int) -> list[PanelAction]:
        """Handle a change of focus: a window without the keyboard receives no release."""
        if focus.on or (self._motion is None and self.work.running is None):
            return []
        self.note = "stopped, because this window has lost the keyboard focus"
        return self._stop_and_block(now_ns)

    def handle_time(self, now_ns: int) -> list[PanelAction]:
        """Handle the passing of time."""
        actions = self._handle_change(self._held_key.check_time(now_ns), now_ns)
        motion = self._motion
        if motion is not None and motion.begun and not motion.waiting and now_ns >= motion.renew_ns:
            motion.velocity = motion.direction * self.key_speed()
            motion.waiting, motion.renew_ns = True, now_ns + RENEW_NS
            actions.append(JogAxis(motion.axis, motion.velocity, renew=True, press=motion.number))
        if motion is None and self._acquired and now_ns >= self._idle_since_ns + IDLE_NS:
            actions += self._release_axes()
        return actions

    def next_tick_ns(self) -> int | None:
        """The instant of the next `handle_time`; None: not before another event."""
        motion = self._motion
        due = [self._held_key.until_ns]
        if motion is not None and motion.begun and not motion.waiting:
            due.append(motion.renew_ns)
        if motion is None and self._acquired:
            due.append(self._idle_since_ns + IDLE_NS)
        return min((instant_ns for instant_ns in due if instant_ns is not None), default=None)

    # Replies

    def handle_acquired(self, axes: list[str], holder: str, now_ns: int) -> list[PanelAction]:
        """Note that the lease was acquired."""
        self._acquiring, self._acquired, self.holder, self._idle_since_ns = False, frozenset(axes), holder, now_ns
        return self._begin_motion(now_ns)

    def handle_acquire_refused(self, refusal: Refusal) -> None:
        """Note that the lease was refused."""
        self._acquiring = False
        self.handle_lease_lost(refusal)

    def handle_lease_lost(self, refusal: Refusal) -> None:
        """Note that the lease has ended, and that its motion was stopped. It is acquired again only at the next key
        press."""
        self._acquired, self.holder = frozenset(), None
        self._show_refusal(refusal)

    def handle_jog_reply(self, jog: JogAxis, refusal: Refusal | None, now_ns: int) -> list[PanelAction]:
        """Handle the reply to a jog. A reply to an earlier key press is ignored."""
        motion = self._motion
        if motion is None or motion.number != jog.press:
            return []
        if refusal is not None:
            self._show_refusal(refusal)
            self._idle_since_ns = now_ns
            return [StopJog()]
        motion.begun, motion.waiting = True, False
        return self.handle_time(now_ns)

    def handle_stop_refused(self, refusal: Refusal) -> None:
        """Note that a stop was refused: without renewals the axis stops anyway. An earlier refusal has priority,
        because it explains more."""
        self.refusal = self.refusal or refusal

    def handle_work_done(self, work: RunWork, refusal: Refusal | None) -> None:
        """Note the end of a work, or why it was not done."""
        self.work.running = None
        self.refusal, self.note = refusal, "" if refusal is not None else f"done: {work.words}"

    def show_note(self, note: str) -> None:
        """Show the result of stopping the fleet."""
        self.note = note

    # Inside

    def _key_bindings(self) -> dict[str, "Callable[[int], list[PanelAction]]"]:
        keys: dict[str, Callable[[int], list[PanelAction]]] = {
            "up": lambda now_ns: self._choose_axis(-1, now_ns),
            "down": lambda now_ns: self._choose_axis(1, now_ns),
            "+": lambda now_ns: self._change_speed(self._step + 1, now_ns),
            "=": lambda now_ns: self._change_speed(self._step + 1, now_ns),
            "-": lambda now_ns: self._change_speed(self._step - 1, now_ns),
            "space": self._stop_and_block,
            "escape": self._stop_and_block,
            "tab": self._choose_step_size,
            "e": lambda now_ns: self._begin_work(now_ns, lambda: self.work.start_enabling(self.chosen_axis)),
            "h": lambda now_ns: self._begin_work(now_ns, lambda: self.work.start_homing(self.chosen_axis, now_ns), "h"),
            "z": lambda now_ns: self._begin_work(
                now_ns, lambda: self.work.start_zeroing(self.chosen_axis, now_ns), "z"
            ),
            "s": lambda now_ns: [*self._stop_and_block(now_ns), RequestFleetStop()],
            "x": lambda now_ns: [RequestFleetEstop(), *self._stop_and_block(now_ns)],
            "q": lambda now_ns: [*self._stop_and_block(now_ns), ExitPanel(0)],
            "ctrl+c": lambda now_ns: [*self._stop_and_block(now_ns), ExitPanel(INTERRUPTED)],
            "ctrl+z": self._refuse_background,
        }
        for digit in range(1, 10):
            step = FRACTIONS.index(digit / 10)
            keys[str(digit)] = lambda now_ns, step=step: self._change_speed(step, now_ns)
        return keys

    def _handle_change(self, grip: KeyChange | None, now_ns: int) -> list[PanelAction]:
        """Handle a change of the held key."""
        if grip is KeyChange.BEGIN:
            self._blocked, self.refusal, self.note = False, None, ""
            if self.work.running is not None:
                return self._refuse_while_working()
            works = self._end_motion(now_ns)
            return [*works, *(self._handle_press(now_ns) if self.work.step_size is None else self._make_step())]
        if grip is KeyChange.GO_ON:
            # A key that is held makes one step.
            return [] if self._blocked or self.work.step_size is not None else self._handle_press(now_ns)
        if grip is KeyChange.SILENT and self._motion is not None:
            self.note = "stopped, because the terminal sends no more events of the key: press it again"
        return self._end_motion(now_ns) if grip is not None else []

    def _handle_press(self, now_ns: int) -> list[PanelAction]:
        assert self._held_key.key is not None
        self._presses += 1
        self._motion = _KeyMotion(self._presses, self.chosen_axis, _DIRECTIONS[self._held_key.key])
        if self.chosen_axis in self._acquired:
            return self._begin_motion(now_ns)
        if self._acquiring:
            return []
        works = self._release_axes()
        self._acquiring = True
        return [*works, AcquireAxis(self.chosen_axis)]

    def _make_step(self) -> list[PanelAction]:
        """Start a step in the direction of the pressed key. Its job acquires the axis itself."""
        assert self._held_key.key is not None
        axis, direction = self.chosen_axis, _DIRECTIONS[self._held_key.key]
        speed = self.key_speed() / self.axes[axis].limits.velocity
        return [*self._release_axes(), self.work.start_step(axis, direction, speed)]

    def _begin_work(self, now_ns: int, start: "Callable[[], RunWork | None]", key: str = "") -> list[PanelAction]:
        """Start the work of a key, or ask for its second press."""
        if self.work.running is not None:
            return self._refuse_while_working()
        self.refusal, self.note = None, ""
        works = self._stop_and_block(now_ns)
        work = start()
        if work is None:
            self.note = f"press {key} again within 3 s"
            return works
        return [*works, *self._release_axes(), work]

    def _refuse_while_working(self) -> list[PanelAction]:
        assert self.work.running is not None
        self._blocked, self.note = True, f"not while it works: {self.work.running.words}; space stops it"
        return []

    def _choose_step_size(self, now_ns: int) -> list[PanelAction]:
        if self.work.running is not None:
            return self._refuse_while_working()
        self.work.choose_next_size()
        return self._stop_and_block(now_ns)

    def _begin_motion(self, now_ns: int) -> list[PanelAction]:
        """Start the motion of the held key, now that its axis is acquired."""
        motion = self._motion
        if motion is None or motion.asked:
            return []
        if motion.axis not in self._acquired:
            # Another axis was chosen while the lease was being acquired.
            self._acquiring = True
            return [*self._release_axes(), AcquireAxis(motion.axis)]
        motion.asked, motion.velocity = True, motion.direction * self.key_speed()
        motion.renew_ns = now_ns + RENEW_NS
        return [JogAxis(motion.axis, motion.velocity, renew=False, press=motion.number)]

    def _end_motion(self, now_ns: int) -> list[PanelAction]:
        """End the motion of a key."""
        motion, self._motion = self._motion, None
        self._idle_since_ns = now_ns
        return [StopJog()] if motion is not None and motion.asked else []

    def _stop_and_block(self, now_ns: int) -> list[PanelAction]:
        """Stop, and ignore the held key until the next press."""
        self._held_key.release_key()
        self._blocked = True
        cancellations = [] if self.work.running is None else [CancelWork()]
        return [*self._end_motion(now_ns), *cancellations]

    def _show_refusal(self, refusal: Refusal) -> None:
        """Show a refusal: nothing moves until the next key press."""
        self._motion, self._blocked, self.refusal = None, True, refusal
        self._held_key.release_key()

    def _release_axes(self) -> list[PanelAction]:
        if not self._acquired:
            return []
        self._acquired, self.holder = frozenset(), None
        return [ReleaseAxis()]

    def _choose_axis(self, by: int, now_ns: int) -> list[PanelAction]:
        self.chosen = (self.chosen + by) % len(self.axes)
        self.work.forget_question()
        return self._stop_and_block(now_ns)

    def _change_speed(self, step: int, now_ns: int) -> list[PanelAction]:
        self._step = max(0, min(len(FRACTIONS) - 1, step))
        if self._motion is not None:
            self._motion.renew_ns = now_ns
        return self.handle_time(now_ns)

    def _refuse_background(self, now_ns: int) -> list[PanelAction]:
        self.note = "the panel cannot run in the background, where key releases are not received; q exits"
        return self._stop_and_block(now_ns)
