"""Motion of axes in closed form."""
