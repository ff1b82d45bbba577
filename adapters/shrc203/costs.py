"""Upper bounds of arming, disarming and stopping, from transmitted characters and the controller's decoding time."""

from adapters.shrc203.options import ShrcOptions
from adapters.shrc203.wire.session import COMPLETION_LATE_NS
from adapters.toolkit.host_start import withdrawable_costs
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.model.state import StepCosts

# Sent and received characters, with CR LF, at their longest for three axes; exchanges.
_CHECK = (7 + 90, 1)  # Q:SPC
_BUFFERS = (6 * 7 + 2 * 36 + 2 * 16 + 2 * 6, 6)  # ?:MPW ?:APW ?:WTW ?:WIW ?:EP ?:KP
_WATCH = (2 * 6 + 36 + 7, 2)  # ?:PW, ?:FW
_LOAD = (120 + 6 + 7 + 125 + 7 + 6, 3)  # MP:, ?:CMD, GC:
_ECHO = (6 + 7 + 4, 2)  # replies, ?:CMD, and line ends, beside the command and its echo
_CLEAR = (3 * (8 + 6), 3)  # MP:a+P0
_STANDBY = (2 * (4 + 4) + 11 + 4 + 7 + 36 + 5 + 4, 4)  # I: twice, WI:, ?:WIW, G:
_RELEASE = (3 * (8 + 6) + 7 + 36 + 3 * (8 + 4), 7)  # MP:a+P0, ?:MPW, WI:a,C
_OUTPUT = (5 + 4 + 6 + 4, 2)  # ?:O, O:
_TRIGGER = (3 + 2 + 4 + 12 + 4 + 5 + 11, 3)  # T:S where one is left, T:P, ?:T
_LONGEST_LINE = 120
_HOST_NS = 2 * NS_PER_MS  # event loop and operating system, for each exchange
_RAMP_MAX_NS = NS_PER_S  # R is 1000 ms at the most (L3157), and a stop uses the ramp of the move


def following_costs(options: ShrcOptions, char_ns: int, load: str, costs: StepCosts) -> StepCosts:
    """Return upper bounds in ns of a step that is loaded by `load` right behind the one before: its end is queried, the
    move loaded and read back."""
    characters = 2 * len(load) + _ECHO[0] + _CHECK[0]
    arm_ns = characters * char_ns + (_ECHO[1] + _CHECK[1]) * _exchange_ns(options)
    lead_ns = options.decode_us * NS_PER_US + len("G:123\r\n") * char_ns
    return withdrawable_costs(costs.model_copy(update={"arm_ns": arm_ns}), lead_ns)


def trigger_cost_ns(options: ShrcOptions, char_ns: int) -> int:
    """Return the upper bound of setting the trigger output before a move is loaded."""
    characters, exchanges = _TRIGGER
    return characters * char_ns + exchanges * _exchange_ns(options)


def _exchange_ns(options: ShrcOptions) -> int:
    """Return the duration of an exchange without its characters."""
    return (options.decode_us + options.decode_spread_us + 2 * options.wire_jitter_us) * NS_PER_US + _HOST_NS


def step_costs(options: ShrcOptions, char_ns: int, *, line: bool = False) -> StepCosts:
    """Return upper bounds in ns for links with this character time. line: for a step with a trigger line."""
    exchange_ns = _exchange_ns(options)

    def take_ns(*parts: tuple[int, int]) -> int:
        return sum(characters * char_ns + exchanges * exchange_ns for characters, exchanges in parts)

    standby = (_STANDBY, _CHECK, _CHECK, _OUTPUT) if line else ()
    release = (_RELEASE, _CHECK, _CHECK, _CHECK, _OUTPUT) if line else ()
    return StepCosts(
        arm_ns=take_ns(_WATCH, _LOAD, _BUFFERS, _CHECK, *standby),
        disarm_ns=take_ns(_BUFFERS, _CLEAR, _BUFFERS, *release) + (COMPLETION_LATE_NS if line else 0),
        stop_ns=_LONGEST_LINE * char_ns + exchange_ns + _RAMP_MAX_NS,
    )
