"""Upper bounds of arming, disarming and stopping, from transmitted characters and the controller's decoding time."""

from math import ceil

from adapters.smc30.lowering import LINES_BEFORE, SlotSchedule
from adapters.smc30.options import Smc30DriverOptions
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.model.state import StepCosts

# Sent and received characters, with address, checksum and CR, at their longest; exchanges.
_CHECK = (4 + 3 + 5 + 11, 2)  # F V1
_POINTS = (5 + 5, 1)  # V2
_LOAD = (5 + 5 + 3 * 9 + 9 + 3 * 12 + 2 * 8 + 3 * 8 + 14 * 3, 14)  # PO PX, S T R, D or N, G T G T G, A D C, Y
_CONVERSION = (10 + 3 + 3, 1)  # con=1.0000
_CURRENT = (7 + 3 + 3, 1)  # CS, CR or CT
_LIST = (4 + 3 + 110, 1)  # Q
_START = (4 + 3, 1)  # E
_TARGET = (19 + 3, 1)  # R509=R510+65528
_SENTINEL = (8 + 8, 1)  # VR510
_STOP = (4 + 3, 1)  # Z
_LONGEST_LINE = 12
_HOST_NS = 2 * NS_PER_MS  # event loop and operating system, for each exchange
_LOOK_NS = 20 * NS_PER_MS


def exchange_ns(options: Smc30DriverOptions, char_ns: int, *parts: tuple[int, int]) -> int:
    """Return the duration of exchanges with these characters."""
    late_us = options.decode_us + options.decode_spread_us + 2 * options.wire_jitter_us + options.hold_us
    each_ns = late_us * NS_PER_US + _HOST_NS
    return sum(characters * char_ns + exchanges * each_ns for characters, exchanges in parts)


def target_arm_ns(options: Smc30DriverOptions, char_ns: int, slots: SlotSchedule) -> int:
    """Return the upper bound of arming behind a step with the same program, ns: currents, target, its read-back."""
    exchanges_ns = exchange_ns(options, char_ns, *_currents(options), _TARGET, _SENTINEL)
    return exchanges_ns + (slots.count - 1) * exchange_ns(options, char_ns, _SENTINEL)


def _currents(options: Smc30DriverOptions) -> list[tuple[int, int]]:
    return [_CURRENT] * (1 + (options.ramp_ma is not None) + (options.top_ma is not None))


def step_costs(options: Smc30DriverOptions, char_ns: int, slots: SlotSchedule, ramp_s: float) -> StepCosts:
    """Return upper bounds in ns for a line with this character time.

    Arming is that of this controller alone, while others are polled: the bounds of several controllers of a line add
    up. Unloading and stopping are those of all controllers of the line at once.

    ramp_s: the longest ramp of the motion that may have to be stopped.
    """
    settle_ns = options.answer_ms * NS_PER_MS + 2 * _LONGEST_LINE * char_ns
    arm_ns = exchange_ns(
        options, char_ns, *_currents(options), _CHECK, _CONVERSION, _LOAD, _LIST, _POINTS, _SENTINEL, _START, _CHECK
    )
    promise_ns = exchange_ns(options, char_ns, _CHECK, _SENTINEL)
    unload_ns = exchange_ns(options, char_ns, _STOP, _CHECK)
    program_ns = (LINES_BEFORE * options.line_us + options.decode_us) * NS_PER_US
    # The stops of all controllers are written in sequence at once; each is repeated in its turn.
    stop_ns = slots.count * (_LONGEST_LINE + _STOP[0]) * char_ns + ceil(ramp_s * NS_PER_S)
    return StepCosts(
        # A program is loaded in one turn: before it, each of the other controllers may have its turn once.
        arm_ns=arm_ns + (slots.count - 1) * exchange_ns(options, char_ns, _SENTINEL),
        disarm_ns=slots.count * (promise_ns + unload_ns + slots.each_ns) + settle_ns + program_ns,
        stop_ns=stop_ns + 2 * settle_ns + slots.count * exchange_ns(options, char_ns, _STOP, _CHECK) + _LOOK_NS,
    )
