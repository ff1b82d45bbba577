"""Shapes of a move in whole numbers of the controller."""
