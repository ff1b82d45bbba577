"""A fleet as an EPICS server: a motor record for each axis, by PVAccess and Channel Access."""
