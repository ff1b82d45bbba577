"""Common to all commands: exit codes, options, output, and the connection to the fleet."""
