"""Shapes of a move: trapezoids, contours and courses in whole samples of the controller."""
