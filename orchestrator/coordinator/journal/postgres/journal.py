"""The journal in PostgreSQL: one schema for each fleet, written by the leader of the latest epoch alone."""

from collections.abc import Callable, Sequence
from typing import NamedTuple

from orchestrator.coordinator.journal.calls import JournalCall
from orchestrator.coordinator.journal.facts import KeyedJob
from orchestrator.coordinator.journal.postgres.address import JournalAddress
from orchestrator.coordinator.journal.postgres.database import PostgresDatabase
from orchestrator.coordinator.journal.postgres.health import JournalHealth
from orchestrator.coordinator.journal.postgres.lines import SeenLine, split_hosts
from orchestrator.coordinator.journal.postgres.names import (
    STANDBY,
    TOOL,
    make_leader_pattern,
    name_schema,
    name_session,
)
from orchestrator.coordinator.journal.postgres.reach import takes_connections
from orchestrator.coordinator.journal.postgres.schema import VERSION, list_columns, migrate, read_version
from orchestrator.coordinator.journal.postgres.session import ANSWER_S, DEADLINE_S, Session, Statement
from orchestrator.coordinator.journal.records import BRING_BACK_DATABASE, HistoryLost, JournalError
from orchestrator.coordinator.journal.sql import tables
from orchestrator.coordinator.journal.sql.grouping import run_group
from orchestrator.coordinator.journal.sql.journal import SqlJournal
from orchestrator.model.messages import MAX_EPOCH_STEP

MIGRATION_S = 60.0
PROBE_S = 1.0  # for another host to say where it is in its history
_END_LEADERS = (
    "SELECT pg_terminate_backend(pid) FROM pg_stat_activity"
    " WHERE datname = current_database() AND application_name ~ ? AND pid <> pg_backend_pid()"
)


class FleetDatabase(NamedTuple):
    """The journal of a fleet in a database. fleet: its name. copies: 1 or 2, the machines that a promise needs.
    coordinator: what names this one in the database. deadline_s: of the statements that are sent together. seen_line:
    the newest line of history that its sessions have seen; None: each knows its own alone. make_session: makes a
    session of an address, a name of it, settings and a deadline."""

    address: JournalAddress
    fleet: str
    copies: int = 1
    coordinator: str = ""
    deadline_s: float = DEADLINE_S
    seen_line: SeenLine | None = None
    make_session: Callable[[JournalAddress, str, str, float], Session] = Session


class PostgresJournal(SqlJournal):
    """`JournalStore` in a database."""

    def __init__(self, place: FleetDatabase, *, is_new: bool = True) -> None:
        """Open the journal; is_new: create it if it is not there. Raises `JournalError`."""
        self._place = place
        self.database = PostgresDatabase(open_session(place, STANDBY), place.copies)
        """The database, for what looks at it, or damages it, from outside."""
        try:
            if is_new:
                _make_schema(self.database, place.fleet)
            require_schema(self.database, place.fleet)
        except JournalError:
            self.database.close()
            raise
        super().__init__(self.database, self.database)

    def close(self) -> None:
        self.database.close()

    def take_epoch(self, seen: int) -> int:
        """As of `JournalStore`; besides, the sessions of the leader of before are ended, and from here on this journal
        writes under the epoch. Raises `HistoryLost` if an adapter has seen a later epoch: with its epochs the database
        has lost what was done under them, and a larger one would let the older history win."""
        db, session = self.database, self.database.session
        # Else the leader that goes on without its copy would end for one that cannot begin.
        db.require_copies()
        require_newest_line(self._place, session)
        # A transaction of a leader that is suspended would hold the row.
        session.run_again([Statement(_END_LEADERS, (make_leader_pattern(self._place.fleet),))])
        with db.lock_leader():
            last = self._read_epoch()
            if last < seen <= last + MAX_EPOCH_STEP:
                raise HistoryLost(
                    f"{db.name}: its epoch is {last}, and a controller has seen {seen}: it has lost history",
                    BRING_BACK_DATABASE,
                )
            epoch = last + 1
            self._values.write("epoch", str(epoch))
            db.write("UPDATE leader SET epoch = ?, coordinator = ?", (epoch, self._place.coordinator))
            name = name_session(self._place.fleet, str(epoch))
            db.select("SELECT set_config('application_name', ?, false)", (name,))
        db.epoch, session.application = epoch, name
        return epoch

    def set_epoch(self, epoch: int) -> None:
        with self.database.lock_leader():
            self._values.write("epoch", str(epoch))
            self.database.write("UPDATE leader SET epoch = ?", (epoch,))

    def require_latest_epoch(self, epoch: int) -> None:
        self.database.require_epoch(epoch)

    def run_group(self, calls: Sequence[JournalCall], epoch: int) -> None:
        """As of `JournalStore`. The epoch is asked for with what is read, in the same round trip."""
        with self.database.under_epoch(epoch):
            run_group(self.database, calls)

    def find_keyed_job(self, owner: str, client_key: str) -> KeyedJob | None:
        """As of `JournalStore`. A row can be visible without being copied: it counts once a later commit is
        confirmed."""
        job = super().find_keyed_job(owner, client_key)
        if job is not None and not self.database.in_transaction:
            with self.database.transaction(copied=True):
                pass
        return job

    def read_health(self) -> JournalHealth:
        """What the database says of itself; from then on the journal knows whether a copy is missing. Raises
        `JournalError`."""
        return self.database.read_health()


def open_session(place: FleetDatabase, role: str) -> Session:
    """A session of a fleet; it connects with its first statement. role: as of `name_session`."""
    settings = (
        f"SET search_path TO \"{name_schema(place.fleet)}\"; SET timezone TO 'UTC'; SET statement_timeout TO 0;"
        f" SET lock_timeout TO 0; SET synchronous_commit TO {'on' if place.copies > 1 else 'local'}"
    )
    name = name_session(place.fleet, role)
    session = place.make_session(place.address, name, settings, place.deadline_s)
    if place.seen_line is not None:
        session.seen_line = place.seen_line
    return session


def require_newest_line(place: FleetDatabase, session: Session) -> None:
    """Raises `HistoryLost` if another host of the address is a primary of a newer line than that of the session. A host
    that does not answer cannot be asked."""
    if (own_line := session.line) is None:
        return
    for address in split_hosts(place.address):
        if not takes_connections(address.conninfo, ANSWER_S):
            continue
        session_there = open_session(place._replace(address=address, seen_line=None, deadline_s=PROBE_S), TOOL)
        try:
            session_there.run([Statement("SELECT 1")])
        except JournalError:
            continue
        finally:
            session_there.close()
        if session_there.line is not None and session_there.line.timeline:
            own_line.require_not_older(session_there.line)


def _make_schema(db: PostgresDatabase, fleet: str) -> None:
    deadline_s = db.session.deadline_s
    db.session.deadline_s = MIGRATION_S
    try:
        migrate(db, name_schema(fleet))
    finally:
        db.session.deadline_s = deadline_s


def require_schema(db: PostgresDatabase, fleet: str) -> None:
    """Raises `JournalError` if the schema of a fleet is not that of this version, with all its columns."""
    schema = name_schema(fleet)
    version = read_version(db, schema)
    if not version:
        raise JournalError(
            f"{db.name}: the journal of fleet {fleet} is missing",
            "give the address of its database, or begin a new one",
        )
    if version < VERSION:
        text = f"{db.name}: schema {version} is older than this Tutti's {VERSION}"
        raise JournalError(text, "start the fleet, which leads it there")
    columns = list_columns(db, schema)
    for table, names in {**tables.RECORDS, **tables.POINTS}.items():
        missing_names = sorted(set(names) - columns.get(table, set()))
        if missing_names:
            part = f"the column {missing_names[0]}" if table in columns else "the table"
            text = f"{db.name}: {part} of {schema}.{table} is missing: it was changed by hand"
            raise JournalError(text, BRING_BACK_DATABASE)
