"""The controller's codes as texts, with remedies for the operator."""

from typing import NamedTuple


class StopCode(NamedTuple):
    """The reason why an axis stopped (SC): the kind of end, a fault code, text and remedy."""

    state: str
    code: str
    text: str
    remedy: str = ""


# L9858-9899
STOP_CODES: dict[int, StopCode] = {
    0: StopCode("fault", "still-running", "still moves in independent mode"),
    1: StopCode("done", "done", "stopped at its target"),
    2: StopCode(
        "fault", "forward-limit", "stopped by the forward limit switch or soft limit", "move it back into its range"
    ),
    3: StopCode(
        "fault", "reverse-limit", "stopped by the reverse limit switch or soft limit", "move it back into its range"
    ),
    4: StopCode("stopped", "stopped", "stopped by a stop command"),
    6: StopCode("fault", "abort-input", "stopped by the abort input", "deactivate the abort input, then reset"),
    7: StopCode("stopped", "aborted", "stopped by an abort command"),
    8: StopCode("fault", "off-on-error", "switched off because its position error grew too large", "check for a jam"),
    9: StopCode("done", "edge-found", "stopped after finding the edge"),
    10: StopCode("done", "home-found", "stopped after homing"),
    11: StopCode("fault", "selective-abort", "stopped by its abort input", "deactivate the input, then reset"),
    40: StopCode("fault", "latch-target", "stopped at a latch target"),
    41: StopCode("fault", "latch-overrun", "overran a latch target"),
    42: StopCode("fault", "latch-short", "stopped short of a latch target"),
    50: StopCode("fault", "contouring", "runs a contour"),
    51: StopCode("done", "contour-end", "stopped at the end of a contour"),
    99: StopCode("fault", "in-position-timeout", "did not reach its position in time", "check for a jam"),
    100: StopCode("fault", "sequence", "executes a vector sequence"),
    101: StopCode("fault", "sequence-end", "stopped at the end of a vector sequence"),
}

# Remedies for the error codes (L10268-10443) that occur in normal operation.
REMEDIES: dict[int, str] = {
    5: "send a shorter line",
    7: "wait for the end of the move, or stop it",
    17: "stop the running program first",
    18: "stop the contour first",
    20: "enable the axis first",
    21: "wait for the end of the move, or stop it",
    22: "move the axis off its limit switch, in the other direction",
    123: "reconnect",
}


def stop_code_meaning(code: int) -> StopCode:
    """Return the meaning of stop code `code`."""
    return STOP_CODES.get(code) or StopCode("fault", f"stop-code-{code}", f"stopped with unknown stop code {code}")
