"""The tables of the journal, and the migrations from older versions."""

import sqlite3

from orchestrator.coordinator.journal.records import JournalError

VERSION = 14
SCHEMA_WITH_COPIES = 6  # the first one that keeps single values twice

SCHEMA = """
CREATE TABLE meta (key TEXT PRIMARY KEY, value TEXT NOT NULL) STRICT;
CREATE TABLE jobs (
  number INTEGER PRIMARY KEY AUTOINCREMENT,
  id TEXT UNIQUE NOT NULL,
  client_key TEXT UNIQUE NOT NULL,
  name TEXT NOT NULL,
  actor TEXT NOT NULL,
  body TEXT NOT NULL,
  state TEXT NOT NULL,
  reason TEXT NOT NULL,
  submitted_utc TEXT NOT NULL
) STRICT;
CREATE INDEX jobs_state ON jobs (state);
CREATE TABLE transitions (
  job_id TEXT NOT NULL REFERENCES jobs (id),
  state TEXT NOT NULL, reason TEXT NOT NULL, actor TEXT NOT NULL, utc TEXT NOT NULL, fleet_ns INTEGER
) STRICT;
CREATE INDEX transitions_job ON transitions (job_id);
CREATE TABLE decisions (
  job_id TEXT NOT NULL, step INTEGER NOT NULL, epoch INTEGER NOT NULL, t0_fleet_ns INTEGER NOT NULL,
  members TEXT NOT NULL, utc TEXT NOT NULL
) STRICT;
CREATE TABLE reports (job_id TEXT PRIMARY KEY REFERENCES jobs (id), body TEXT NOT NULL) STRICT;
"""
# The statements that lead from each version to the next; a new journal runs all of them.
MIGRATIONS = {
    1: """
CREATE TABLE recordings (
  job_id TEXT NOT NULL REFERENCES jobs (id), step INTEGER NOT NULL, body TEXT NOT NULL,
  PRIMARY KEY (job_id, step)
) STRICT;
""",
    2: """
ALTER TABLE jobs ADD COLUMN priority INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN place INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN repeat INTEGER NOT NULL DEFAULT 1;
ALTER TABLE jobs ADD COLUMN after_job TEXT;
ALTER TABLE jobs ADD COLUMN at_utc TEXT;
ALTER TABLE jobs ADD COLUMN missed TEXT NOT NULL DEFAULT 'skip';
ALTER TABLE jobs ADD COLUMN due INTEGER NOT NULL DEFAULT 1;
ALTER TABLE jobs ADD COLUMN held_by TEXT NOT NULL DEFAULT '';
ALTER TABLE jobs ADD COLUMN origin TEXT;
ALTER TABLE jobs ADD COLUMN from_step INTEGER NOT NULL DEFAULT 0;
UPDATE jobs SET place = number;
CREATE TABLE hands (
  holder TEXT PRIMARY KEY, actor TEXT NOT NULL, what TEXT NOT NULL, axes TEXT NOT NULL, until_utc TEXT NOT NULL
) STRICT;
CREATE INDEX decisions_job ON decisions (job_id);
""",
    3: """
ALTER TABLE hands RENAME TO reservations;
UPDATE jobs SET state = 'paused' WHERE state = 'holding';
UPDATE transitions SET state = 'paused' WHERE state = 'holding';
UPDATE reports SET body = replace(replace(replace(replace(replace(replace(body,
  '"state":"holding"', '"state":"paused"'),
  '"holds":', '"feed_holds":'),
  '"by_line":', '"by_trigger_line":'),
  '"name":"slip"', '"name":"tick-residual"'),
  '"code":"held"', '"code":"feed-hold"'),
  '"code":"deposed"', '"code":"leadership-lost"');
""",
    4: """
ALTER TABLE jobs ADD COLUMN expires_utc TEXT;
ALTER TABLE jobs ADD COLUMN now INTEGER NOT NULL DEFAULT 0;
ALTER TABLE jobs ADD COLUMN session TEXT;
""",
    5: """
CREATE TABLE meta_copies (key TEXT PRIMARY KEY, value TEXT NOT NULL, crc INTEGER NOT NULL) STRICT;
ALTER TABLE jobs ADD COLUMN crc INTEGER;
""",
    6: """
CREATE TABLE job_points (job_id TEXT NOT NULL, digest TEXT NOT NULL, PRIMARY KEY (job_id, digest)) STRICT;
CREATE TABLE point_rows (
  job_id TEXT NOT NULL, step INTEGER NOT NULL, point INTEGER NOT NULL, state TEXT NOT NULL, verdict TEXT NOT NULL,
  t0_fleet_ns INTEGER, skew_least_ns INTEGER, skew_most_ns INTEGER, took_s REAL, target TEXT NOT NULL,
  measured TEXT NOT NULL, PRIMARY KEY (job_id, step, point)
) STRICT, WITHOUT ROWID;
""",
    7: """
CREATE TABLE positions (name TEXT PRIMARY KEY, body TEXT NOT NULL, crc INTEGER NOT NULL) STRICT;
""",
    8: """
CREATE TABLE alarms (id TEXT PRIMARY KEY, body TEXT NOT NULL, crc INTEGER NOT NULL) STRICT;
CREATE TABLE alarm_history (number INTEGER PRIMARY KEY AUTOINCREMENT, body TEXT NOT NULL) STRICT;
CREATE TABLE alarm_notices (
  change TEXT PRIMARY KEY, body TEXT NOT NULL, crc INTEGER NOT NULL, tries INTEGER NOT NULL DEFAULT 0
) STRICT;
CREATE TABLE statistics (
  day TEXT NOT NULL, kind TEXT NOT NULL, subject TEXT NOT NULL, figure TEXT NOT NULL, value REAL NOT NULL,
  PRIMARY KEY (day, kind, subject, figure)
) STRICT, WITHOUT ROWID;
""",
    9: """
ALTER TABLE jobs ADD COLUMN proposed INTEGER NOT NULL DEFAULT 0;
CREATE TABLE approvals (
  job_id TEXT PRIMARY KEY REFERENCES jobs (id), body TEXT NOT NULL, crc INTEGER NOT NULL
) STRICT;
CREATE TABLE commands (
  number INTEGER PRIMARY KEY AUTOINCREMENT, utc TEXT NOT NULL, actor TEXT NOT NULL, verb TEXT NOT NULL,
  subject TEXT NOT NULL, refused TEXT NOT NULL
) STRICT;
""",
    # From here on a key stands behind its owner, in `client_key`: that is unique, and cannot be made anew.
    10: """
ALTER TABLE jobs ADD COLUMN request_digest TEXT NOT NULL DEFAULT '';
""",
    11: """
ALTER TABLE jobs ADD COLUMN continues TEXT;
""",
    12: """
ALTER TABLE point_rows ADD COLUMN flown TEXT;
""",
    13: """
CREATE TABLE learned (controller TEXT PRIMARY KEY, body TEXT NOT NULL, crc INTEGER NOT NULL) STRICT;
""",
}


def list_statements(version: int, wanted: int = VERSION) -> str:
    """The statements that lead from a schema version, 0 for an empty database, to the wanted one; empty: none."""
    steps = "" if version else SCHEMA
    return steps + "".join(MIGRATIONS[number] for number in range(max(version, 1), wanted))


def read_version(db: sqlite3.Connection, path: str) -> int:
    """The schema version of a database, 0 for an empty one. Raises `JournalError` for one that is no journal, or newer
    than this Tutti, and `sqlite3.Error`."""
    version: int = db.execute("PRAGMA user_version").fetchone()[0]
    if version > VERSION:
        text = f"{path}: schema {version} is newer than this Tutti's {VERSION}"
        raise JournalError(text, "use a newer Tutti")
    if not version and db.execute("SELECT count(*) FROM sqlite_master").fetchone()[0]:
        text = f"{path}: the file is a database, but not a journal of Tutti"
        raise JournalError(text, "choose another path for the journal")
    return version
