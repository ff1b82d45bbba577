"""A fleet on this machine, as processes."""
