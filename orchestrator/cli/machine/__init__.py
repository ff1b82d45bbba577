"""Commands about the computers of a fleet: their adapter hosts, services, and checks."""
