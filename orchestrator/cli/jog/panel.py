"""What the jog panel does, without a terminal and without a bus: keys, time and answers in, requests out.

The one who has it performs the actions that its methods give, in order, and tells it what came of them.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field

from orchestrator.cli.codes import INTERRUPTED
from orchestrator.cli.jog.held_key import Grip, Hold
from orchestrator.cli.jog.keys import Focus, Key
from orchestrator.clock.base import NS_PER_MS, NS_PER_S
from orchestrator.model.fleet import Axis
from orchestrator.model.messages import Refusal
from orchestrator.model.report import Lease
from orchestrator.model.state import AxisState, ControllerState

# A jog is good for 200 ms: two renewals may be lost or late before the axis stops.
RENEW_NS = 60 * NS_PER_MS
IDLE_NS = 3 * NS_PER_S  # without motion, until others may have the axis

FRACTIONS = (0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8, 0.9, 1.0)
FIRST_FRACTION = 0.2

_DIRECTIONS = {"left": -1, "right": 1}


@dataclass(frozen=True, slots=True)
class TakeAxis:
    """Take the lease of an axis; then `taken` or `refused`."""

    axis: str


@dataclass(frozen=True, slots=True)
class GiveBack:
    """Give the lease back, after what was asked before."""


@dataclass(frozen=True, slots=True)
class Jog:
    """Jog at `velocity` (unit/s); then `jogged` or `refused`. hold: which press of a key it belongs to."""

    axis: str
    velocity: float
    renew: bool
    hold: int


@dataclass(frozen=True, slots=True)
class Halt:
    """Stop what is jogged, at once, whatever else is still to be answered."""


@dataclass(frozen=True, slots=True)
class StopFleet:
    """As `tutti stop`."""


@dataclass(frozen=True, slots=True)
class EstopFleet:
    """As `tutti estop`."""


@dataclass(frozen=True, slots=True)
class Leave:
    """End with this exit code; what moves is stopped and the lease given back."""

    code: int


Action = TakeAxis | GiveBack | Jog | Halt | StopFleet | EstopFleet | Leave


@dataclass(slots=True)
class _Motion:
    """What one press of a key moves."""

    number: int
    axis: str
    direction: int
    asked: bool = False
    begun: bool = False
    waiting: bool = False  # for the answer to a renewal
    renew_ns: int = 0
    velocity: float = 0.0


@dataclass(slots=True)
class JogPanel:
    """The panel. `axes`: those that are shown, `controller.axis`, with their configurations. Instants on one clock, ns.

    refusal: the last one; note: anything else that people should know. Both stand until the next press.
    """

    axes: Mapping[str, Axis]
    releases: bool
    fleet: str = ""
    chosen: int = 0
    states: dict[str, ControllerState] = field(default_factory=dict[str, ControllerState])
    seen_ns: dict[str, int] = field(default_factory=dict[str, int])
    leases: dict[str, Lease] = field(default_factory=dict[str, Lease])
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

    # What is shown

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
        """-1, 0 or 1: where the held key moves the chosen axis."""
        return self._motion.direction if self._motion else 0

    @property
    def leased(self) -> bool:
        """Whether the chosen axis is in hand."""
        return self.axis in self._held

    def now(self, axis: str) -> AxisState | None:
        """What is known of an axis; None when nothing is."""
        controller, _, name = axis.partition(".")
        state = self.states.get(controller)
        return None if state is None or state.mode == "offline" else state.axes.get(name)

    def jog_speed(self, axis: str) -> float:
        """The largest speed at which the axis may be jogged now, unit/s."""
        now = self.now(axis)
        return self.axes[axis].jog_speed(now is not None and now.referenced)

    def speed(self) -> float:
        """The speed that a key means now, unit/s."""
        return self.fraction * self.jog_speed(self.axis)

    def held_by(self, axis: str) -> str:
        """Who may move an axis: "", "you", or somebody in words."""
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

    # What is heard

    def hear(self, state: ControllerState, now_ns: int) -> None:
        """A controller's state."""
        self.states[state.controller], self.seen_ns[state.controller] = state, now_ns

    def hear_lease(self, lease: Lease) -> None:
        """Who has what."""
        self.leases[f"{lease.controller}/{lease.axis}" if lease.axis else lease.controller] = lease

    # Keys and time

    def key(self, key: Key, now_ns: int) -> list[Action]:
        """A key has said something."""
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
        """A window without the keyboard hears no release."""
        if focus.on or self._motion is None:
            return []
        self.note = "stopped, because this window has lost the keyboard"
        return self._let_go(now_ns)

    def tick(self, now_ns: int) -> list[Action]:
        """Time has passed."""
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
        """When `tick` is wanted next; None: not before something else happens."""
        motion = self._motion
        due = [self._hold.until_ns]
        if motion is not None and motion.begun and not motion.waiting:
            due.append(motion.renew_ns)
        if motion is None and self._held:
            due.append(self._idle_since_ns + IDLE_NS)
        return min((each for each in due if each is not None), default=None)

    # Answers

    def taken(self, axes: list[str], holder: str, now_ns: int) -> list[Action]:
        """The lease is here."""
        self._taking, self._held, self.holder, self._idle_since_ns = False, frozenset(axes), holder, now_ns
        return self._begin(now_ns)

    def not_taken(self, refusal: Refusal) -> None:
        """The lease was refused."""
        self._taking = False
        self.lost(refusal)

    def lost(self, refusal: Refusal) -> None:
        """The lease has ended, and what it moved was stopped. Taken again only when a key is pressed anew."""
        self._held, self.holder = frozenset(), None
        self._block(refusal)

    def answered(self, jog: Jog, refusal: Refusal | None, now_ns: int) -> list[Action]:
        """What came of a jog. An answer to an earlier press says nothing of this one."""
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
        """A stop was not accepted: silence stops the axis. The refusal that was first says more."""
        self.refusal = self.refusal or refusal

    def told(self, note: str) -> None:
        """What came of stopping the fleet."""
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
        """What the held key means."""
        if grip is Grip.BEGIN:
            self._blocked, self.refusal, self.note = False, None, ""
            return [*self._end(now_ns), *self._press(now_ns)]
        if grip is Grip.GO_ON:
            return [] if self._blocked else self._press(now_ns)
        if grip is Grip.SILENT and self._motion is not None:
            self.note = "stopped, because the terminal says nothing more of the key: press it again"
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
        """Set in motion what the held key wants, now that its axis is in hand."""
        motion = self._motion
        if motion is None or motion.asked:
            return []
        if motion.axis not in self._held:
            # Another axis was chosen while the lease was on its way.
            self._taking = True
            return [*self._give_back(), TakeAxis(motion.axis)]
        motion.asked, motion.velocity = True, motion.direction * self.speed()
        motion.renew_ns = now_ns + RENEW_NS
        return [Jog(motion.axis, motion.velocity, False, motion.number)]

    def _end(self, now_ns: int) -> list[Action]:
        """End what a key moves."""
        motion, self._motion = self._motion, None
        self._idle_since_ns = now_ns
        return [Halt()] if motion is not None and motion.asked else []

    def _let_go(self, now_ns: int) -> list[Action]:
        """Stop, and wait for a key to be pressed anew."""
        self._hold.drop()
        self._blocked = True
        return self._end(now_ns)

    def _block(self, refusal: Refusal) -> None:
        """Something was refused: nothing moves until a key is pressed anew."""
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
        self.note = "the panel can not be put into the background: a held key would not be heard; q leaves"
        return self._let_go(now_ns)
