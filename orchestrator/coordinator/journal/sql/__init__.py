"""The journal in SQL that SQLite and PostgreSQL both take: everything but where the rows are."""
