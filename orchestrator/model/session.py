"""Sessions of commands that a person waits for."""

SIGN_PERIOD_NS = 200_000_000
"""Period of a session's signs of life."""
SESSION_TIMEOUT_NS = 1_000_000_000
"""A session without a sign of life for this long is over: five signs are missing."""
