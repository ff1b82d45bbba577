"""Stored programs, their threads, and their editor."""
