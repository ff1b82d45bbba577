"""Which coordinator leads the fleet."""
