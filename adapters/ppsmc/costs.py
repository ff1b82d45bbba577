"""Upper bounds of arming, disarming and stopping, from commands, their execution, and transmitted characters."""

from collections.abc import Iterable

from adapters.ppsmc.options import PpSmcOptions
from adapters.ppsmc.trapezoid import PpSmcBounds
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.model.state import StepCosts

_LINES_PER_AXIS = 6  # frun, ffast, acc, dec, tbs, and one in reserve
_LINES = 34  # the check before, tokens, tbc, the program's frame, inputs and outputs; and a poll that is under way
_VERIFY_LINES = 22  # the check before the commit, for which there must be time as well; and a poll
_WATCH_LINES = 5  # tokens of the check of settings, ?conf, and one in reserve
_LINE_CHARACTERS = 24
_SETTINGS_CHARACTERS = 600  # of ?conf for one axis
_DISARM_LINES = 14
_WAIT_LINES = 30  # `go` starts the waiting program: it must run this long before its trigger line at the latest
_STOP_LINES = 4
_HOST_NS = 20 * NS_PER_MS  # event loop and operating system, for all exchanges of a call
_SLOWEST_STOP_S = 2.0  # of a ramp in a step; see `trapezoid`


def step_costs(options: PpSmcOptions, char_ns: int, installed: int, stop_s: float, *, waits: bool = False) -> StepCosts:
    """Return upper bounds in ns for links with this character time.

    installed: number of axes of the controller. stop_s: the longest ramp. waits: for a step that a trigger line starts.
    """
    slow_ns = options.decode_ns[1]
    wire_ns = 2 * options.wire_jitter_us * NS_PER_US

    def take_ns(lines: int, characters: int, exchanges: int) -> int:
        return lines * (slow_ns + _LINE_CHARACTERS * char_ns) + characters * char_ns + exchanges * wire_ns + _HOST_NS

    # On a serial line the settings are compared with those that arming reads anyway.
    watch_lines = 0 if char_ns else _WATCH_LINES
    return StepCosts(
        arm_ns=take_ns(
            _LINES + _VERIFY_LINES + watch_lines + _LINES_PER_AXIS * installed, _SETTINGS_CHARACTERS * installed, 7
        ),
        disarm_ns=take_ns(_DISARM_LINES + (_WAIT_LINES if waits else 0), 0, 4),
        stop_ns=take_ns(_STOP_LINES, 0, 1) + round(stop_s * NS_PER_S),
    )


def longest_stop_s(limits: Iterable[PpSmcBounds]) -> float:
    """Return the longest ramp from full speed that a step or a jog can have."""
    return max(max(_SLOWEST_STOP_S, limit.speed / (1000.0 * max(1, limit.ramp_max))) for limit in limits)
