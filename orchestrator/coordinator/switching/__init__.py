"""Outputs that a step switches on the way: what their owners are asked for, and what became of it."""
