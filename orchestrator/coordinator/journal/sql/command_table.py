"""The commands of users in the journal: the newest ones, in their order."""

from orchestrator.coordinator.journal.sql.database import JournalPart
from orchestrator.model.operation.commands import CommandRecord

MAX_COMMANDS = 100_000  # that are kept; some 10 MB

_STORE = (
    "INSERT INTO commands (number, utc, actor, verb, subject, refused)"
    " SELECT coalesce(max(number), 0) + 1, ?, ?, ?, ?, ? FROM commands"
)


class CommandTable(JournalPart):
    """`CommandStore`: the table of commands in one database. Every method raises `JournalError`."""

    def store_command(self, command: CommandRecord) -> None:
        with self._db.transaction():
            values = (command.utc, command.actor, command.verb, command.subject, command.refused)
            self._db.write(_STORE, values)
            # Numbers have no gaps: each transaction deletes at most one row.
            newest = "(SELECT max(number) FROM commands)"
            self._db.write(f"DELETE FROM commands WHERE number <= {newest} - ?", (MAX_COMMANDS,))

    def list_commands(self, limit: int, before_utc: str | None = None, by: str = "") -> list[CommandRecord]:
        conditions: list[str] = ["number > 0"]
        values: list[object] = []
        if before_utc is not None:
            conditions.append("utc < ?")
            values.append(before_utc)
        if by:
            conditions.append("replace(actor, ?, '') <> actor")  # it contains that
            values.append(by)
        query = f"SELECT utc, actor, verb, subject, refused FROM commands WHERE {' AND '.join(conditions)}"
        rows = self._db.select(f"{query} ORDER BY number DESC LIMIT ?", (*values, limit))
        return [CommandRecord(utc=u, actor=a, verb=v, subject=s, refused=r) for u, a, v, s, r in rows]
