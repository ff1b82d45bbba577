"""Parts that several makes share."""
