"""Stored programs and their interpreter."""
