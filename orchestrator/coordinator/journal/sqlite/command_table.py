"""The commands of users in the journal: the newest ones, in their order."""

import sqlite3

from orchestrator.coordinator.journal.sqlite.transaction import DATABASE_ERRORS, Transaction, make_unusable_error
from orchestrator.model.operation.commands import CommandRecord

MAX_COMMANDS = 100_000  # that are kept; some 10 MB


class CommandTable:
    """`CommandStore`: the table of commands in one database. Every method raises `JournalError`."""

    def __init__(self, db: sqlite3.Connection, path: str) -> None:
        self._db = db
        self._path = path

    def store_command(self, command: CommandRecord) -> None:
        with Transaction(self._db, self._path):
            values = (command.utc, command.actor, command.verb, command.subject, command.refused)
            row = self._db.execute(
                "INSERT INTO commands (utc, actor, verb, subject, refused) VALUES (?, ?, ?, ?, ?)", values
            )
            # Numbers have no gaps before the oldest one: each transaction deletes at most one row.
            self._db.execute("DELETE FROM commands WHERE number <= ?", ((row.lastrowid or 0) - MAX_COMMANDS,))

    def list_commands(self, limit: int, before_utc: str | None = None, by: str = "") -> list[CommandRecord]:
        query = (
            "SELECT utc, actor, verb, subject, refused FROM commands"
            " WHERE (? IS NULL OR utc < ?) AND (? = '' OR instr(actor, ?) > 0) ORDER BY number DESC LIMIT ?"
        )
        try:
            rows = self._db.execute(query, (before_utc, before_utc, by, by, limit)).fetchall()
        except DATABASE_ERRORS as error:
            raise make_unusable_error(self._path, error) from None
        return [CommandRecord(utc=u, actor=a, verb=v, subject=s, refused=r) for u, a, v, s, r in rows]
