"""The recorder: what it takes, what it costs, and what is left after a cut or a kill."""
