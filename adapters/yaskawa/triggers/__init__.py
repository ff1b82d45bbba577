"""Triggers on the way: a table of samples that the resident program plays beside the motion."""
