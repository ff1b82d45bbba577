"""Measures the gateway and the operators' page."""
