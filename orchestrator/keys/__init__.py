"""The keys of a fleet: its authority, certificates, roles, and the router's access table."""
