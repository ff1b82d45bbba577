"""Synchronised motion steps."""
