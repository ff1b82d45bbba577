"""Fleet files and schemas."""
