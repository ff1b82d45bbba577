"""Continuous paths as files of other programs give them."""
