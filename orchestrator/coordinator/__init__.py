"""The coordinator: leads a fleet, adopts its controllers, schedules jobs, and runs motion steps."""
