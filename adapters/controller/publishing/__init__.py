"""A controller on the bus: its state, events, clock and trace."""
