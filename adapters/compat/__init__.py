"""What makes of an earlier version of the contract need."""
