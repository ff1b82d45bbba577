"""Commands for named positions."""
