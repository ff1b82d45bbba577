"""The journal in PostgreSQL, which another machine may take over. Needs the extra `tutti[postgres]`."""
