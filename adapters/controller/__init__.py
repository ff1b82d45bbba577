"""One controller on the bus, whatever its make."""
