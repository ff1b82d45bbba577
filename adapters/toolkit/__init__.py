"""Components that several makes share."""
