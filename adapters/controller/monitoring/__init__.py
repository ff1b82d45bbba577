"""Readings of a controller: polled, checked for rest and for what was not ordered."""
