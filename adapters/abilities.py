"""What a driver may offer beyond `Driver`: a make has the methods of such a protocol, or states nothing.

Callers ask once by `isinstance`, when they are created. What a make does not have is refused or not done, as each
protocol says. Units and errors are those of `adapters.contract`.
"""

from collections.abc import Mapping, Sequence
from typing import Protocol, runtime_checkable

from adapters.contract import (
    ChunkFit,
    Driver,
    JogMove,
    LatchedPosition,
    LimitMove,
    PathChunk,
    ProbedContact,
    ProbeMove,
    SampledPositions,
    SamplingPlan,
    SettingDifference,
    SwitchedOutput,
)
from orchestrator.clock.estimator import TickMapping
from orchestrator.clock.latency import StartLatency
from orchestrator.clock.rate import CrystalRate
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import DigitalInput
from orchestrator.model.profile import Profile
from orchestrator.model.state import ProbeAbility


@runtime_checkable
class SettingsDriver(Protocol):
    """A driver that compares settings. Without it nothing is compared."""

    async def check_settings(self, *, everything: bool) -> Sequence[SettingDifference]:
        """Compare what motion relies on with what the controller holds now, and return the differences.

        That is what `configure` has loaded or checked and a second client can change: scaling, filters, coupling,
        modes, ranges, limits, resident programs. everything: all of it, before a step is armed (`costs.arm_ns` covers
        it); otherwise the next part, in turn, of a controller at rest. `clear_faults` writes again what it can.
        """
        ...


@runtime_checkable
class LearningDriver(Protocol):
    """A driver that learns about the starts and the crystal of a make without a readable clock. Without it nothing is
    published about them."""

    def crystal_rate(self) -> CrystalRate:
        """Return what finished moves have shown about the crystal."""
        ...

    def start_latency(self) -> StartLatency:
        """Return what earlier starts have shown about the time from a start command to the start."""
        ...

    def forget_starts(self) -> None:
        """Forget what earlier starts have added to the bounds of a start. Nothing is sent to the controller."""
        ...


@runtime_checkable
class PathDriver(Protocol):
    """A driver that loads a long path in chunks while the controller executes it, with a `chunk_s` in its
    `capabilities`. Without it a chunk is refused (code `no-chunks`)."""

    async def load_chunk(self, chunk: PathChunk, mapping: TickMapping | None) -> ChunkFit:
        """Load the next chunk of the path that the controller executes; without `release_chunk` it is not executed.

        A chunk may begin inside the present one, and end before it: the present one is cut short there. Raises
        `Refusal`; then the controller continues as if nothing had been loaded.
        """
        ...

    async def release_chunk(self, number: int) -> None:
        """Have the controller change over to the chunk that was loaded last, in one act of its own. Raises `Refusal`
        (code `late`): then it certainly continues with the present one."""
        ...


@runtime_checkable
class RetargetDriver(Protocol):
    """A driver that continues a move to another target on the way, with a `retarget_s` in its `capabilities`. Without
    it the axes brake, and start again."""

    async def retarget(self, profiles: Mapping[str, Profile], from_s: float) -> Mapping[str, float]:
        """Continue the present move by other profiles, which are the present ones up to `from_s` after its start, and
        return how long it takes, by axis, s from its start. Raises `Refusal` (code `late`: what comes behind `from_s`
        is sent already); then it continues as before."""
        ...


@runtime_checkable
class SamplingDriver(Protocol):
    """A driver whose controller records positions by itself. Without it a recording is refused (code `no-sampling`)."""

    async def begin_sampling(self, axes: Sequence[str], period_ns: int, seconds: float) -> SamplingPlan:
        """Have the controller record the actual positions of `axes` from now on for `seconds`, at least every
        `period_ns`; what was recorded before is dropped.

        Called at rest, before a step is armed; axes of the same controller may be armed and moved meanwhile. Raises
        `Refusal` (code `sampling-period`, `sampling-space` with what would fit).
        """
        ...

    async def take_samples(self) -> SampledPositions:
        """Stop recording, fetch what was recorded, and free its memory. Called at rest. Raises `Refusal`."""
        ...


@runtime_checkable
class TriggerDriver(Protocol):
    """A driver whose controller switches outputs on the way, or whose lowered moves have `triggers`. Without it no
    output has done anything."""

    async def take_triggers(self) -> Mapping[str, SwitchedOutput]:
        """Return what the outputs with triggers did in the last step, by output; called after its end, however it
        ended, and before another one is armed. Raises `Refusal`."""
        ...


@runtime_checkable
class ShownTriggerDriver(TriggerDriver, Protocol):
    """A driver of which it can be read while a path in chunks is executed what its outputs with triggers have done
    (`ChunkTriggers.shows`)."""

    async def read_triggers(self, known: Mapping[str, int]) -> Mapping[str, SwitchedOutput]:
        """Return what the outputs of the present step have done since the last time, by output: their edges behind the
        first ones, whose numbers are in `known`. Called while it moves. Raises `Refusal`."""
        ...


@runtime_checkable
class LatchDriver(Protocol):
    """A driver whose controller captures positions by inputs. Without it that is refused (code `no-latch`)."""

    async def latch_position(self, axis: str, point: DigitalInput, within_ns: int) -> LatchedPosition:
        """Arm the latch of an axis, and return the position that it has captured when the input became active.

        within_ns: how long it waits. Ends with a stop, too. Raises `Refusal` (code `latch-input` for an input that does
        not latch the axis; `line-level` if it is active already; `latch-timeout`).
        """
        ...


@runtime_checkable
class ProbeDriver(Protocol):
    """A driver whose controller stops an axis by an input. Without it only its host can."""

    @property
    def probe_ability(self) -> ProbeAbility:
        """Which inputs stop which axes, and how far an axis goes on at most. Known before it is connected."""
        ...

    async def probe_axis(self, axis: str, move: ProbeMove) -> ProbedContact | None:
        """Move an axis from rest, stop it when the input changes, and return the contact when it is at rest; None: it
        is at rest at its end, and the input has not changed.

        Behind the contact the axis goes no farther than `probe_ability.find_overtravel`. A caller that cancels it has
        the axis stop. Raises `Refusal`: the axis has not moved (code `probe-input` for an input that does not stop the
        axis, `line-level` if it has that level already), or it was stopped (code `stopped`, `probe-broken`).
        """
        ...


@runtime_checkable
class LimitProbeDriver(Protocol):
    """A driver that finds a limit switch. Without it no probe ends by one."""

    @property
    def limit_ability(self) -> ProbeAbility | None:
        """How a limit switch stops its axis; the inputs have no meaning. Known before it is connected; None: as
        without this protocol."""
        ...

    async def probe_limit(self, axis: str, move: LimitMove) -> ProbedContact | None:
        """As `ProbeDriver.probe_axis`, with the limit switch that the axis moves to."""
        ...


@runtime_checkable
class LineProbeDriver(Protocol):
    """A driver whose controller stops several axes on a straight line by an input. Without it each probes alone."""

    @property
    def line_ability(self) -> ProbeAbility | None:
        """As `ProbeDriver.probe_ability`, for each axis of a line, with its own speed and ramp. None: as without this
        protocol."""
        ...

    async def probe_line(self, moves: Mapping[str, ProbeMove]) -> Mapping[str, ProbedContact] | None:
        """As `ProbeDriver.probe_axis`, with several axes, all of which move, by one input. They begin, brake and end
        together: off the line at most by `ProbeAbility.find_off_line`. Raises `Refusal` as there."""
        ...


@runtime_checkable
class ManualDriver(Protocol):
    """A driver whose axes can be jogged. Without it a jog is refused (code `no-jog`)."""

    async def jog_axis(self, axis: str, move: JogMove) -> None:
        """Begin to jog one axis, or change to `move` while it jogs; return when the controller has accepted the
        command.

        Other jogging axes continue. The jog runs until `stop_axes`, `Driver.stop`, `move.end_counts` or a limit switch:
        the caller limits its duration. Raises `Refusal`; then this call does not move the axis.
        """
        ...

    async def stop_axes(self, axes: Sequence[str]) -> None:
        """Stop jogging axes by their ramps; others continue.

        Returns when the command is sent; never waits for an outstanding reply, and may be called at any moment,
        concurrently with any other call.
        """
        ...


@runtime_checkable
class LimitDriver(Protocol):
    """A driver whose controller keeps soft limits of its own. Without it plans and jogs alone keep them."""

    async def load_soft_limits(self, limits: Mapping[str, tuple[int, int] | None]) -> None:
        """Load the controller's own soft limits, (low, high) in counts by axis; None for an axis whose position is
        unknown, which these limits must not restrict.

        Raises `ControllerFault` (code `config-mismatch`) when the controller does not hold these values afterwards.
        """
        ...


@runtime_checkable
class OutputDriver(Protocol):
    """A driver whose controller has outputs. Without it switching one is refused (code `no-output`)."""

    async def set_output(self, number: int, *, on: bool) -> None:
        """Switch an output on or off. Raises `Refusal`."""
        ...


@runtime_checkable
class SharedLineDriver(Protocol):
    """A driver that may share its link with other controllers. Without it the link is the controller's own."""

    async def stop_before_connect(self) -> bool:
        """Stop a controller that may be moving before anything else is sent to it, over a link that it shares with
        other controllers.

        Return False for a controller with a link of its own: the caller then opens that link and writes the make's
        `stop_bytes`. Raises `LinkRefused`, `LinkClosed`.
        """
        ...


ABILITIES: tuple[type, ...] = (
    SettingsDriver,
    LearningDriver,
    PathDriver,
    SamplingDriver,
    TriggerDriver,
    ShownTriggerDriver,
    LatchDriver,
    ProbeDriver,
    LineProbeDriver,
    LimitProbeDriver,
    ManualDriver,
    LimitDriver,
    OutputDriver,
    SharedLineDriver,
)


async def find_differences(driver: Driver, *, everything: bool) -> Sequence[SettingDifference]:
    """Return the settings that differ, as `SettingsDriver.check_settings` does; none where nothing is compared."""
    return await driver.check_settings(everything=everything) if isinstance(driver, SettingsDriver) else ()


async def set_output(driver: Driver, number: int, *, on: bool) -> None:
    """Switch an output. Raises `Refusal`."""
    if not isinstance(driver, OutputDriver):
        raise Refusal("no-output", f"there is no output {number}: this make has none", "")
    await driver.set_output(number, on=on)
