"""A wired line that the resident program waits for, or drives: what is loaded for it, and what is promised of it."""

import math
from dataclasses import dataclass

from adapters.contract import CannotDo
from adapters.toolkit.wired_points import driven, waited_for
from adapters.yaskawa.common.options import Options
from orchestrator.clock.base import NS_PER_US
from orchestrator.clock.estimator import TickMapping
from orchestrator.model.fleet import Controller
from orchestrator.model.messages import LineDrive, LineWait, StartWay, Term

LOCAL_POINTS = 8  # AI takes local inputs only, OB local outputs (L2490, L630)


@dataclass(frozen=True, slots=True)
class Wait:
    """An input that begins the move. number: negative when low is active, as AI takes it (L2488)."""

    name: str
    number: int

    def require_passive(self, inputs: int) -> None:
        """AI looks at the level, not at an edge (L2533): an active one would let the program through at once.

        inputs: bit 0 is input 1, set where it is high. Raises `CannotDo`.
        """
        if bool(inputs >> (abs(self.number) - 1) & 1) == (self.number > 0):
            raise CannotDo(
                "line-level",
                f"input {self.name} is active already, and would start the move at once",
                "look for what drives its line; `tutti wiring check` finds a wrong polarity",
            )


@dataclass(frozen=True, slots=True)
class Drive:
    """An output that the program makes active at the start. level: what OB sets for that."""

    name: str
    number: int
    level: int
    hold_ticks: int

    def require_passive(self, outputs: int) -> None:
        """outputs: bit 0 is output 1, set where it is on. Raises `CannotDo`."""
        if outputs >> (self.number - 1) & 1 == self.level:
            raise CannotDo("line-level", f"output {self.name} is active already", "switch it off: `tutti io set`")


def wait(config: Controller, asked: LineWait) -> Wait:
    """Raises `CannotDo` for an input that the controller does not have, or can not wait for."""
    point = waited_for(config, asked)
    if point.number > LOCAL_POINTS:
        raise CannotDo(
            "start-class",
            f"input {asked.input} is number {point.number}; a start can wait for inputs 1 to {LOCAL_POINTS}",
            "wire the line to one of these",
        )
    return Wait(asked.input, point.number if point.active == "high" else -point.number)


def drive(config: Controller, asked: LineDrive, tick_ns: float) -> Drive:
    """Raises `CannotDo` for an output that the controller does not have."""
    point = driven(config, asked)
    return Drive(asked.output, point.number, int(point.active == "high"), math.ceil(asked.hold_ns / tick_ns))


def wait_terms(asked: LineWait, waits: Wait, options: Options, tick_ns: float) -> tuple[Term, ...]:
    """The start about T0, from the edge on: the optocoupler, the sample that finds it, the begin behind AI.

    Whether AI looks at samples only is not said: it may let go at once.
    """
    opto_us = options.input_rise_us if waits.number > 0 else options.input_fall_us
    first, last = options.begin_ticks(tick_ns)
    return (
        Term(name="line", earliest_ns=asked.earliest_ns, latest_ns=asked.latest_ns),
        Term(name="input", earliest_ns=0, latest_ns=opto_us * NS_PER_US + math.ceil(tick_ns)),
        Term(name="tick", earliest_ns=math.floor((first - 1) * tick_ns), latest_ns=math.ceil(last * tick_ns)),
    )


def clock_terms(bound_ns: int, options: Options, mapping: TickMapping, how: StartWay, beside: bool) -> tuple[Term, ...]:
    """The start about T0 by the controller's own clock. beside: a line is driven at the same sample, in a thread whose
    command may come first."""
    tick_ns = mapping.tick_ns
    first, last = options.begin_ticks(tick_ns, beside)
    return (
        *_at_sample(bound_ns, mapping, how),
        Term(name="tick", earliest_ns=0, latest_ns=math.ceil((last - first) * tick_ns)),
    )


def edge_terms(bound_ns: int, options: Options, mapping: TickMapping, how: StartWay) -> tuple[Term, ...]:
    """The edge about T0: OB comes behind the wait for XT0, as BG does, but takes effect at once."""
    tick_ns = mapping.tick_ns
    first, _ = options.begin_ticks(tick_ns)
    ahead_ns = round(first * tick_ns)
    latest_ns = (options.begin_max_us + options.beside_us) * NS_PER_US
    return (
        *_at_sample(bound_ns, mapping, how),
        Term(
            name="firmware",
            earliest_ns=options.decode_min_us * NS_PER_US - ahead_ns,
            latest_ns=latest_ns - ahead_ns,
        ),
    )


def _at_sample(bound_ns: int, mapping: TickMapping, how: StartWay) -> tuple[Term, Term]:
    """The sample that is next to T0: on either side of it, or where it is once T0 is known."""
    half_tick_ns = math.ceil(mapping.tick_ns / 2)
    off = (-half_tick_ns, half_tick_ns)
    if how.exact:
        t0_ns = mapping.host_at_ns + how.lead_ns
        off = (mapping.host_ns(round(mapping.ticks(t0_ns))) - t0_ns,) * 2
    return (
        Term(name="clock", earliest_ns=-bound_ns, latest_ns=bound_ns),
        Term(name="quantisation", earliest_ns=off[0], latest_ns=off[1]),
    )
