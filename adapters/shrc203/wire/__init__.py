"""Replies of an SHRC-203: their formats, and frames in words."""
