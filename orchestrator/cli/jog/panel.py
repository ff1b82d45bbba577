"""The logic of the jog panel, without a terminal and without a bus: keys, time and replies in, requests out.

The session performs the actions that the methods return, in order, and reports their results to the panel.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from orchestrator.cli.codes import INTERRUPTED
from orchestrator.cli.jog.held_key import Grip, Hold
from orchestrator.cli.jog.keys import Focus, Key
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
class TakeAxis:
    """Acquire the lease of an axis; then `taken` or `refused`."""

    axis: str


@dataclass(frozen=True, slots=True)
class GiveBack:
    """Release the lease, after all earlier requests."""


@dataclass(frozen=True, slots=True)
class Jog:
    """Jog at `velocity` (unit/s); then `jogged` or `refused`. hold: number of the key press that it belongs to."""

    axis: str
    velocity: float
    renew: bool
    hold: int


@dataclass(frozen=True, slots=True)
class Halt:
    """Stop the jogged axis immediately, whatever replies are still missing."""


@dataclass(frozen=True, slots=True)
class StopFleet:
    """Like `tutti stop`."""


@dataclass(frozen=True, slots=True)
class EstopFleet:
    """Like `tutti estop`."""


@dataclass(frozen=True, slots=True)
class Leave:
    """Exit with this code; the motion is stopped and the lease released."""

    code: int


Action = TakeAxis | GiveBack | Jog | Halt | StopFleet | EstopFleet | Leave


@dataclass(slots=True)
class _Motion:
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
    _held: frozenset[str] = frozenset()
    _taking: bool = False
    _step: int = FRACTIONS.index(FIRST_FRACTION)
    _motion: _Motion | None = None
    _presses: int = 0
    _blocked: bool = False
    _idle_since_ns: int = 0
    _hold: Hold = field(init=False)

    def __post_init__(self) -> None:
        self._hold = Hold(self.releases)

    # Displayed values

    @property
    def axis(self) -> str:
        """The chosen axis."""
        return list(self.axes)[self.chosen]

    @property
    def fraction(self) -> float:
        """The speed as a fraction of the axis's jog speed."""
        return FRACTIONS[self._step]

    @property
    def direction(self) -> int:
        """-1, 0 or 1: the direction in which the held key moves the chosen axis."""
        return self._motion.direction if self._motion else 0

    @property
    def leased(self) -> bool:
        """Whether the lease of the chosen axis is acquired."""
        return self.axis in self._held

    def now(self, axis: str) -> AxisState | None:
        """Return the known state of an axis; None without one."""
        controller, _, name = axis.partition(".")
        state = self.states.get(controller)
        return None if state is None or state.mode == "offline" else state.axes.get(name)

    def jog_speed(self, axis: str) -> float:
        """Return the largest permitted jog speed of the axis now, unit/s."""
        now = self.now(axis)
        return self.axes[axis].jog_speed(now is not None and now.referenced)

    def speed(self) -> float:
        """The speed of a key press now, unit/s."""
        return self.fraction * self.jog_speed(self.axis)

    def held_by(self, axis: str) -> str:
        """Describe the holder of an axis: "", "you", or another user or job."""
        controller, _, name = axis.partition(".")
        state = self.states.get(controller)
        holder = state.leases.get(name) if state else None
        if axis in self._held or (holder is not None and holder == self.holder):
            return "you"
        if holder is None:
            return ""
        lease = self.leases.get(f"{controller}/{name}") or self.leases.get(controller)
        if lease is None or lease.holder != holder:
            return holder
        return f"{lease.actor} ({lease.what})" if lease.what else lease.actor

    # Received states

    def hear(self, state: ControllerState, now_ns: int) -> None:
        """Store a controller's state."""
        self.states[state.controller], self.seen_ns[state.controller] = state, now_ns

    def hear_lease(self, lease: LeaseState) -> None:
        """Store a change of a lease."""
        self.leases[f"{lease.controller}/{lease.axis}" if lease.axis else lease.controller] = lease

    # Keys and time

    def key(self, key: Key, now_ns: int) -> list[Action]:
        """Handle a key event."""
        if key.name in _DIRECTIONS:
            return self._grip(self._hold.take(key, now_ns), now_ns)
        self._hold.alive(now_ns)
        if key.kind == "release":
            return []
        bound = self._bindings().get(key.name)
        if bound is None or (key.kind == "repeat" and key.name not in ("+", "=", "-", "up", "down")):
            return []
        return bound(now_ns)

    def focus(self, focus: Focus, now_ns: int) -> list[Action]:
        """Handle a change of focus: a window without the keyboard receives no release."""
        if focus.on or self._motion is None:
            return []
        self.note = "stopped, because this window has lost the keyboard focus"
        return self._let_go(now_ns)

    def tick(self, now_ns: int) -> list[Action]:
        """Handle the passing of time."""
        actions = self._grip(self._hold.look(now_ns), now_ns)
        motion = self._motion
        if motion is not None and motion.begun and not motion.waiting and now_ns >= motion.renew_ns:
            motion.velocity = motion.direction * self.speed()
            motion.waiting, motion.renew_ns = True, now_ns + RENEW_NS
            actions.append(Jog(motion.axis, motion.velocity, True, motion.number))
        if motion is None and self._held and now_ns >= self._idle_since_ns + IDLE_NS:
            actions += self._give_back()
        return actions

    def due_ns(self) -> int | None:
        """The instant of the next `tick`; None: not before another event."""
        motion = self._motion
        due = [self._hold.until_ns]
        if motion is not None and motion.begun and not motion.waiting:
            due.append(motion.renew_ns)
        if motion is None and self._held:
            due.append(self._idle_since_ns + IDLE_NS)
        return min((each for each in due if each is not None), default=None)

    # Replies

    def taken(self, axes: list[str], holder: str, now_ns: int) -> list[Action]:
        """Note that the lease was acquired."""
        self._taking, self._held, self.holder, self._idle_since_ns = False, frozenset(axes), holder, now_ns
        return self._begin(now_ns)

    def not_taken(self, refusal: Refusal) -> None:
        """Note that the lease was refused."""
        self._taking = False
        self.lost(refusal)

    def lost(self, refusal: Refusal) -> None:
        """Note that the lease has ended, and that its motion was stopped. It is acquired again only at the next key
        press."""
        self._held, self.holder = frozenset(), None
        self._block(refusal)

    def answered(self, jog: Jog, refusal: Refusal | None, now_ns: int) -> list[Action]:
        """Handle the reply to a jog. A reply to an earlier key press is ignored."""
        motion = self._motion
        if motion is None or motion.number != jog.hold:
            return []
        if refusal is not None:
            self._block(refusal)
            self._idle_since_ns = now_ns
            return [Halt()]
        motion.begun, motion.waiting = True, False
        return self.tick(now_ns)

    def not_halted(self, refusal: Refusal) -> None:
        """Note that a stop was refused: without renewals the axis stops anyway. An earlier refusal has priority,
        because it explains more."""
        self.refusal = self.refusal or refusal

    def told(self, note: str) -> None:
        """Show the result of stopping the fleet."""
        self.note = note

    # Inside

    def _bindings(self) -> dict[str, "Callable[[int], list[Action]]"]:
        keys: dict[str, Callable[[int], list[Action]]] = {
            "up": lambda now_ns: self._choose(-1, now_ns),
            "down": lambda now_ns: self._choose(1, now_ns),
            "+": lambda now_ns: self._faster(self._step + 1, now_ns),
            "=": lambda now_ns: self._faster(self._step + 1, now_ns),
            "-": lambda now_ns: self._faster(self._step - 1, now_ns),
            "space": self._let_go,
            "escape": self._let_go,
            "s": lambda now_ns: [*self._let_go(now_ns), StopFleet()],
            "!": lambda now_ns: [EstopFleet(), *self._let_go(now_ns)],
            "q": lambda now_ns: [*self._let_go(now_ns), Leave(0)],
            "ctrl+c": lambda now_ns: [*self._let_go(now_ns), Leave(INTERRUPTED)],
            "ctrl+z": self._no_background,
        }
        for digit in range(1, 10):
            step = FRACTIONS.index(digit / 10)
            keys[str(digit)] = lambda now_ns, step=step: self._faster(step, now_ns)
        return keys

    def _grip(self, grip: Grip | None, now_ns: int) -> list[Action]:
        """Handle a change of the held key."""
        if grip is Grip.BEGIN:
            self._blocked, self.refusal, self.note = False, None, ""
            return [*self._end(now_ns), *self._press(now_ns)]
        if grip is Grip.GO_ON:
            return [] if self._blocked else self._press(now_ns)
        if grip is Grip.SILENT and self._motion is not None:
            self.note = "stopped, because the terminal sends no more events of the key: press it again"
        return self._end(now_ns) if grip is not None else []

    def _press(self, now_ns: int) -> list[Action]:
        assert self._hold.key is not None
        self._presses += 1
        self._motion = _Motion(self._presses, self.axis, _DIRECTIONS[self._hold.key])
        if self.axis in self._held:
            return self._begin(now_ns)
        if self._taking:
            return []
        back = self._give_back()
        self._taking = True
        return [*back, TakeAxis(self.axis)]

    def _begin(self, now_ns: int) -> list[Action]:
        """Start the motion of the held key, now that its axis is acquired."""
        motion = self._motion
        if motion is None or motion.asked:
            return []
        if motion.axis not in self._held:
            # Another axis was chosen while the lease was being acquired.
            self._taking = True
            return [*self._give_back(), TakeAxis(motion.axis)]
        motion.asked, motion.velocity = True, motion.direction * self.speed()
        motion.renew_ns = now_ns + RENEW_NS
        return [Jog(motion.axis, motion.velocity, False, motion.number)]

    def _end(self, now_ns: int) -> list[Action]:
        """End the motion of a key."""
        motion, self._motion = self._motion, None
        self._idle_since_ns = now_ns
        return [Halt()] if motion is not None and motion.asked else []

    def _let_go(self, now_ns: int) -> list[Action]:
        """Stop, and ignore the held key until the next press."""
        self._hold.drop()
        self._blocked = True
        return self._end(now_ns)

    def _block(self, refusal: Refusal) -> None:
        """Show a refusal: nothing moves until the next key press."""
        self._motion, self._blocked, self.refusal = None, True, refusal
        self._hold.drop()

    def _give_back(self) -> list[Action]:
        if not self._held:
            return []
        self._held, self.holder = frozenset(), None
        return [GiveBack()]

    def _choose(self, by: int, now_ns: int) -> list[Action]:
        self.chosen = (self.chosen + by) % len(self.axes)
        return self._let_go(now_ns)

    def _faster(self, step: int, now_ns: int) -> list[Action]:
        self._step = max(0, min(len(FRACTIONS) - 1, step))
        if self._motion is not None:
            self._motion.renew_ns = now_ns
        return self.tick(now_ns)

    def _no_background(self, now_ns: int) -> list[Action]:
        self.note = "the panel cannot run in the background, where key releases are not received; q exits"
        return self._let_go(now_ns)
