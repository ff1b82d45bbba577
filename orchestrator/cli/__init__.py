"""The `tutti` command. It composes all others and is imported by none."""
