"""The `tutti` command. It composes all other packages; none of them imports it."""
