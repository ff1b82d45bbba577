"""Metrics of a fleet, for Prometheus."""
