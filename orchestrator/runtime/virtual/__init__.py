"""A fleet in virtual time, in one process."""
