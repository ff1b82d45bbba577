"""Job intake, queue and execution."""
