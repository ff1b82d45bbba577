"""Paths from files of other programs: G-code, tables of points, trajectories of joints."""
