"""Stop codes, as `SC` reports them."""

FORWARD_CODE, REVERSE_CODE, STOP_CODE, ABORT_INPUT_CODE, ABORT_CODE, ERROR_CODE = 2, 3, 4, 6, 7, 8
SELECTIVE_CODE = 11
"""Stopped by the selective abort of `CN` (L9860)."""
LATCH_CODE, LATCH_OVERRUN_CODE, LATCH_SHORT_CODE = 40, 41, 42
"""Stop code at the target of LT, stopped on the way to it, or too near to stop (L7151-L7159)."""
