"""Statistics of the operation, by day."""
