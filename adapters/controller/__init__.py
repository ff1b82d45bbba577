"""One controller on the bus, independent of its make."""
