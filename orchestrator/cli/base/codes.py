"""Exit codes of the `tutti` command; its help documents them."""

FAILED, BAD_INPUT, UNREACHABLE, INTERRUPTED = 1, 2, 3, 130
