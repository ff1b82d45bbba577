"""Operation by hand: axes, positions, inputs and outputs."""
