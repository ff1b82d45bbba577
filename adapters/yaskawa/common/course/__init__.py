"""Paths that are longer than the controller's arrays: contours that are loaded while they are played."""
