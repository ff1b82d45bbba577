"""The journal in SQLite, on disk before anything is reported."""
