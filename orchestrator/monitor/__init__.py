"""Read-only views of the fleet for people."""
