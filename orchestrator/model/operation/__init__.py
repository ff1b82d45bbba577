"""What is kept of the operation of a fleet: alarms and statistics."""
