"""The databases of one virtual fleet: a primary and its synchronous standbys, each on a machine of its own.

There is one set of contents: those of the present primary. A standby that follows it has the same; one that does not
keeps a copy of the instant at which it was lost. A transaction begins and ends within one call: none waits for another.
"""

import re
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Literal, Protocol

from orchestrator.clock.base import NS_PER_MS
from orchestrator.coordinator.journal.sqlite.database import MEMORY, SqliteDatabase, connect_database
from orchestrator.coordinator.journal.sqlite.journal import SqliteJournal
from orchestrator.model.queue import CopyMode

CommitMoment = Literal["before", "during", "after"]
"""Of a commit: it was not done yet; it is done and its answer is not sent; its answer is sent."""
CALL_NS = NS_PER_MS  # there and back
EPOCH_BEGIN = "2026-01-01T00:00:00Z"

# What a database has besides the tables of records, as in PostgreSQL.
_SERVER_TABLES = (
    "CREATE TABLE leader (epoch INTEGER NOT NULL, coordinator TEXT NOT NULL)",
    "CREATE TABLE lease (renewals INTEGER NOT NULL, renewed TEXT NOT NULL)",
    "CREATE TABLE marks (writer TEXT NOT NULL, number INTEGER NOT NULL)",
    "CREATE TABLE confirmations (number INTEGER NOT NULL)",
    "INSERT INTO leader VALUES (0, '')",
    f"INSERT INTO lease VALUES (0, '{EPOCH_BEGIN}')",
    "INSERT INTO marks VALUES ('', 0)",
    "INSERT INTO confirmations VALUES (0)",
)
_FUNCTIONS = {"current_setting": 1, "set_config": 3, "clock_timestamp": 0, "pg_current_wal_flush_lsn": 0}
"""Of PostgreSQL, with the number of their values."""


class SiteSession(Protocol):
    """A session that is connected."""

    application: str

    def lose_connection(self) -> None: ...


class DatabaseSite:
    """The machines with a database. machines: their names, the first of which is the primary; each other one is a
    standby that confirms commits. Names of other computers are those of coordinators."""

    def __init__(self, machines: tuple[str, ...] = ("db-a", "db-b")) -> None:
        self.machines = machines
        self.primary = machines[0]
        self.timeline = 1
        self.position = 0
        """In the log: how many commits there were."""
        self.call_ns = CALL_NS
        """How long a call takes, there and back."""
        self.commit_ns = 0
        """How much longer a commit takes."""
        self.is_silent = False
        """Whether a machine that is dead does not answer at all; else its system refuses connections."""
        self.facts: tuple[str, ...] = ()
        """What the present call stores or asks: names of the calls of a journal, or of a lease."""
        self.on_commit: Callable[[CommitMoment, str], None] = lambda _, __: None
        """Called at each commit, with the computer of its session."""
        self.journal = SqliteJournal(MEMORY)
        """The contents of the primary."""
        self.sessions: list[SiteSession] = []
        """Those that are connected."""
        self._dead: set[str] = set()
        self._cuts: set[frozenset[str]] = set()
        self._lost_copies: dict[str, SqliteDatabase] = {}
        db, points = self.journal.database, self.journal.point_database
        for (statement,) in points.select("SELECT sql FROM sqlite_master WHERE type = 'table' AND sql IS NOT NULL"):
            db.write(statement)
        for statement in _SERVER_TABLES:
            db.write(statement)
        for name, count in _FUNCTIONS.items():
            db.connection.create_function(name, count, partial(self._call, name))

    def _call(self, function: str, *values: str) -> str:
        """What a function of PostgreSQL returns."""
        match function:
            case "current_setting":
                return "*" if len(self.machines) > 1 else ""
            case "pg_current_wal_flush_lsn":
                return f"0/{self.position:X}"
            case "set_config":
                return values[1]
            case _:  # clock_timestamp
                return EPOCH_BEGIN

    # What sessions ask

    def answers(self, machine: str, computer: str) -> bool:
        """Whether a database runs and is reached from a computer."""
        return machine not in self._dead and frozenset((machine, computer)) not in self._cuts

    def is_cut(self, machine: str, computer: str) -> bool:
        """Whether nothing at all comes back from there."""
        is_silent = self.is_silent and machine in self._dead
        return is_silent or frozenset((machine, computer)) in self._cuts

    @property
    def standbys(self) -> list[str]:
        """Those that have what the primary has, and confirm its commits."""
        return [name for name in self.machines if name != self.primary and name not in self._lost_copies]

    @property
    def mode(self) -> CopyMode:
        """As a fleet that asks for two copies should see it."""
        return "two copies" if self.standbys else "waits for a copy"

    def end_sessions(self, pattern: str, own: SiteSession) -> int:
        """End the sessions whose application name matches; return how many."""
        ended_sessions = [
            session for session in self.sessions if session is not own and re.match(pattern, session.application)
        ]
        for session in ended_sessions:
            session.lose_connection()
        return len(ended_sessions)

    # What happens to machines

    def kill(self, machine: str) -> None:
        """A machine dies."""
        self._keep_copies(machine if machine == self.primary else "", machine)
        self._dead.add(machine)
        if machine == self.primary:
            self._lose_sessions()

    def revive(self, machine: str) -> None:
        """A machine is there again: as the primary that it was, or as a standby of the present one."""
        self._dead.discard(machine)
        self._follow()

    def cut(self, one: str, other: str) -> None:
        """Cut the network between two machines."""
        self._cuts.add(frozenset((one, other)))
        if self.primary in (one, other):
            for machine in {one, other} & set(self.machines) - {self.primary}:
                self._keep_copies("", machine)

    def join(self, one: str, other: str) -> None:
        """Mend the network between two machines."""
        self._cuts.discard(frozenset((one, other)))
        self._follow()

    def find_successor(self) -> str | None:
        """The standby that can be promoted without a loss; without one, any that runs."""
        living_machines = [name for name in self.machines if name != self.primary and name not in self._dead]
        return next((name for name in living_machines if name in self.standbys), next(iter(living_machines), None))

    def promote(self, machine: str) -> None:
        """Make a standby the primary; the site keeps the former one from taking writes until it is revived."""
        former_primary = self.primary
        if former_primary not in self._dead:
            self.kill(former_primary)
        self._lost_copies.pop(former_primary, None)
        contents = self._lost_copies.pop(machine, None)
        if contents is not None:
            contents.connection.backup(self.journal.database.connection)
        self.primary = machine
        self.timeline += 1
        self._lost_copies[former_primary] = self._copy_contents()
        self._lose_sessions()
        self._follow()

    def _follow(self) -> None:
        """Let every standby that reaches the primary have what it has."""
        if self.primary in self._dead:
            return
        for machine in list(self._lost_copies):
            if self.answers(machine, self.primary):
                del self._lost_copies[machine]
        for machine in self.standbys:
            if not self.answers(machine, self.primary):
                self._lost_copies[machine] = self._copy_contents()

    def _keep_copies(self, primary: str, machine: str) -> None:
        """Keep what the standbys of a primary have, or one of them has, that is about to be lost."""
        for name in self.standbys if primary else [machine]:
            if name not in self._lost_copies:
                self._lost_copies[name] = self._copy_contents()

    def _copy_contents(self) -> SqliteDatabase:
        copy = SqliteDatabase(connect_database(MEMORY, check_same_thread=False), MEMORY)
        self.journal.database.connection.backup(copy.connection)
        return copy

    def _lose_sessions(self) -> None:
        for session in list(self.sessions):
            with suppress(ValueError):
                session.lose_connection()
