"""The journal: accepted jobs, decisions and reports in SQLite."""
