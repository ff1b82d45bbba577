"""E-stop buttons that are armed in a process of their own."""
