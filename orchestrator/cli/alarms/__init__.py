"""`tutti alarm …`."""
