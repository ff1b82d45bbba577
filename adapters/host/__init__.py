"""The adapter host process and its guardian."""
