"""The coordinator's view of the fleet: states, requests, leases and permits."""
