"""Scans that fly: their lines, and the motion through them."""
