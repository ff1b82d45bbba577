"""`tutti journal …`."""
