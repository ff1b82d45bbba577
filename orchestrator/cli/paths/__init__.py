"""Commands for paths."""
