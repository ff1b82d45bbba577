"""Trigger lines that the resident program waits for or drives, and outputs that it switches on the way: the loaded
values, and the guaranteed timing."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from adapters.contract import ChunkInstants, SwitchedOutput
from adapters.toolkit.wired_points import find_driven_output, find_wait_input
from adapters.yaskawa.common.options import YaskawaOptions
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import BudgetTerm, StartOptions, TriggerDrive, TriggerWait

LOCAL_POINTS = 8  # AI takes local inputs only, OB local outputs (L2490, L630)


@dataclass(frozen=True, slots=True)
class ProgramWait:
    """An input that starts the move. number: negative when low is active, as AI takes it (L2488)."""

    name: str
    number: int

    def require_passive(self, inputs: int) -> None:
        """Check that the input is passive: AI tests the level, not an edge (L2533), and an active input would let the
        program pass at once.

        inputs: bit 0 is input 1, set where it is high. Raises `Refusal`.
        """
        if bool(inputs >> (abs(self.number) - 1) & 1) == (self.number > 0):
            raise Refusal(
                "line-level",
                f"input {self.name} is already active, and would start the move at once",
                "find the source of this level; `tutti wiring check` detects a wrong polarity",
            )


@dataclass(frozen=True, slots=True)
class ProgramOutput:
    """An output that the program activates at the start. level: the value that OB sets for that."""

    name: str
    number: int
    level: int
    active_ticks: int

    def require_passive(self, outputs: int) -> None:
        """Check that the output is passive. outputs: bit 0 is output 1, set where it is on. Raises `Refusal`."""
        if outputs >> (self.number - 1) & 1 == self.level:
            raise Refusal("line-level", f"output {self.name} is already active", "switch it off: `tutti io set`")


@dataclass(frozen=True, slots=True)
class ProgramTriggers:
    """An output that the program switches at instants after T0. turns: its level changes each time; otherwise it is a
    pulse of `output.active_ticks`. end_ns: of a path in chunks, the end of what is released, after T0; the table is a
    ring then."""

    output: ProgramOutput
    instants_ns: tuple[int, ...]
    turns: bool
    end_ns: int | None = None

    @property
    def last_ns(self) -> int:
        """After T0, when it has nothing to switch any more."""
        return self.instants_ns[-1] if self.end_ns is None else self.end_ns

    def level_of(self, number: int) -> int:
        """The level that the output is set to at an instant."""
        return self.output.level if not self.turns or number % 2 == 0 else 1 - self.output.level


class LoadedStep(Protocol):
    """The step beside which a table is played. ticks: XT0; t0_ns: T0, of the host; both may be brought forward."""

    @property
    def ticks(self) -> int: ...

    @property
    def t0_ns(self) -> int: ...

    @property
    def mapping(self) -> TickMapping: ...


class PartRelease(NamedTuple):
    """What releases the triggers of a chunk: XRN is to be `place`, no later than `ahead_ticks` before the first one
    that comes or goes with it."""

    place: int
    ahead_ticks: int


class OutputPlayer(Protocol):
    """Plays the triggers of a step."""

    def forget(self) -> None:
        """Forget the last table: the controller may no longer have it."""
        ...

    async def load(self, switches: ProgramTriggers, step: LoadedStep) -> None:
        """Load the table, read it back, and start its program, which waits for the gate. Raises `Refusal`."""
        ...

    async def is_playing(self) -> bool:
        """Whether the program still plays the table, once no axis moves; a ring that is played to its end is ended."""
        ...

    async def load_part(self, instants: ChunkInstants, end_ns: int, mapping: TickMapping) -> BudgetTerm:
        """Load the triggers of the next chunk of a path, which ends at `end_ns` after T0; return what the clock may be
        off at them. Raises `Refusal`."""
        ...

    def plan_release(self) -> PartRelease | None:
        """What releases them; None if nothing changes."""
        ...

    def take_part(self) -> None:
        """They are released."""
        ...

    async def read(self, known: Mapping[str, int]) -> Mapping[str, SwitchedOutput]:
        """What the output of a path has done behind its first edges, whose number is in `known`. Raises `Refusal`."""
        ...

    async def take(self) -> Mapping[str, SwitchedOutput]:
        """What the output did, by the stamps of the program. Raises `Refusal`."""
        ...


def resolve_wait_input(config: Controller, requested: TriggerWait) -> ProgramWait:
    """Return the input to wait for. Raises `Refusal` for an input that the controller does not have, or cannot wait
    for."""
    point = find_wait_input(config, requested)
    if point.number > LOCAL_POINTS:
        raise Refusal(
            "start-class",
            f"input {requested.input} is number {point.number}; a start can wait for inputs 1 to {LOCAL_POINTS}",
            "connect the trigger line to one of these inputs",
        )
    return ProgramWait(requested.input, point.number if point.active == "high" else -point.number)


def resolve_driven_output(config: Controller, requested: TriggerDrive, tick_ns: float) -> ProgramOutput:
    """Return the output to drive. Raises `Refusal` for an output that the controller does not have."""
    point = find_driven_output(config, requested)
    return ProgramOutput(
        requested.output, point.number, int(point.active == "high"), math.ceil(requested.active_ns / tick_ns)
    )


def wait_terms(
    requested: TriggerWait, waits: ProgramWait, options: YaskawaOptions, tick_ns: float
) -> tuple[BudgetTerm, ...]:
    """Return the terms of a start by trigger line relative to T0, from the edge on: the optocoupler, the sample that
    detects it, the begin after AI.

    The manual does not state whether AI tests only at samples: it may react at once.
    """
    opto_us = options.input_rise_us if waits.number > 0 else options.input_fall_us
    first, last = options.begin_ticks(tick_ns)
    return (
        BudgetTerm(name="line", earliest_ns=requested.earliest_ns, latest_ns=requested.latest_ns),
        BudgetTerm(name="input", earliest_ns=0, latest_ns=opto_us * NS_PER_US + math.ceil(tick_ns)),
        BudgetTerm(name="tick", earliest_ns=math.floor((first - 1) * tick_ns), latest_ns=math.ceil(last * tick_ns)),
    )


def clock_terms(
    bound_ns: int, options: YaskawaOptions, mapping: TickMapping, start: StartOptions, *, drives_line: bool
) -> tuple[BudgetTerm, ...]:
    """Return the terms of a start by the controller's own clock relative to T0.

    drives_line: a trigger line is driven at the same sample, by a thread whose command may come first."""
    tick_ns = mapping.tick_ns
    first, last = options.begin_ticks(tick_ns, interleaved=drives_line)
    return (
        *_sample_terms(bound_ns, mapping, start),
        BudgetTerm(name="tick", earliest_ns=0, latest_ns=math.ceil((last - first) * tick_ns)),
    )


def edge_terms(
    bound_ns: int, options: YaskawaOptions, mapping: TickMapping, start: StartOptions, drives: ProgramOutput
) -> tuple[BudgetTerm, ...]:
    """Return the terms of the driven edge relative to T0: OB follows the wait for XT0, as BG does, but takes effect at
    once; the output's terminal follows."""
    tick_ns = mapping.tick_ns
    first, _ = options.begin_ticks(tick_ns)
    ahead_ns = round(first * tick_ns)
    latest_ns = (options.begin_max_us + options.interleaved_us) * NS_PER_US
    return (
        *_sample_terms(bound_ns, mapping, start),
        BudgetTerm(
            name="firmware",
            earliest_ns=options.decode_min_us * NS_PER_US - ahead_ns,
            latest_ns=latest_ns - ahead_ns,
        ),
        BudgetTerm(
            name="output",
            earliest_ns=0,
            latest_ns=(options.output_on_us if drives.level else options.output_off_us) * NS_PER_US,
        ),
    )


def _sample_terms(bound_ns: int, mapping: TickMapping, start: StartOptions) -> tuple[BudgetTerm, BudgetTerm]:
    """Return the terms of the sample nearest to T0: on either side of it, or at its known offset once T0 is known."""
    half_tick_ns = math.ceil(mapping.tick_ns / 2)
    off = (-half_tick_ns, half_tick_ns)
    if start.exact:
        t0_ns = mapping.host_at_ns + start.lead_ns
        off = (mapping.to_host_ns(round(mapping.to_ticks(t0_ns))) - t0_ns,) * 2
    return (
        BudgetTerm(name="clock", earliest_ns=-bound_ns, latest_ns=bound_ns),
        BudgetTerm(name="quantisation", earliest_ns=off[0], latest_ns=off[1]),
    )
