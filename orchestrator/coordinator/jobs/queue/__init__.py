"""The queue: which jobs wait, which begin, and how they end."""
