"""Fleet files in short: entries that are written once for many, and fragments, expanded before validation."""
