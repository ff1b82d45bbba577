"""Points of scans on the command line."""
