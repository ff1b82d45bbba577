"""What faults do to the bus, to disks and to replies, and how that is repaired."""
