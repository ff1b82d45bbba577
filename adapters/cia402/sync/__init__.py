"""The SYNCs of a bus: those that start steps, and those of the streams that follow."""
