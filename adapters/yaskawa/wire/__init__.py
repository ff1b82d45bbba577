"""The exchanges with a controller over one handle: commands and replies, records, and the handles themselves."""
