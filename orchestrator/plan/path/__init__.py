"""Continuous paths: geometry by arc length, corners, and the fastest motion that keeps every axis within its limits."""
