"""Motion and settings by hand: leases, jogs, motors, references."""
