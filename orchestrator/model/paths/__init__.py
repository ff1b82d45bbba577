"""Continuous paths as files and requests give them: pieces, corners, and frames."""
