"""Simulated controllers on the level of the wire: bytes in, bytes out, axes that move."""
