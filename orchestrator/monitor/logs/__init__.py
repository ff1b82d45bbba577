"""The log lines of all processes of a fleet: read, placed in fleet time, filtered, in words."""
