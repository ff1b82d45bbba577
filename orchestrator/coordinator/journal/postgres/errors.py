"""What is wrong with a database, in words with a remedy each."""

import psycopg

from orchestrator.coordinator.journal.postgres.certificate import find_certificate_reason
from orchestrator.coordinator.journal.records import BRING_BACK_DATABASE, JournalError


class ConnectionLost(JournalError):
    """The connection ended, or no answer came in time. What was not committed before is not stored."""


class AnswerLate(ConnectionLost):
    """No answer came before the deadline, and the connection was closed."""


_SERVER = "see whether its server runs, and the network to it"
_SPACE = "free space on the disk of the database"
_READS = "it takes no writes: a standby, or read-only"
_PRIMARY = "name the primary in the address, or promote this one"
_FULL = "the server has no connection left"
_SESSIONS = "end sessions, or raise max_connections there"
_BUSY = "another session was in the way"
_CERTIFICATE = "its certificate is not accepted"

# Of a connection there is no code, only the server's text. The first that is in it counts.
_REFUSED = (
    ("password", "the password is wrong or missing", "put it into ~/.pgpass, or name its file by PGPASSFILE"),
    ("pg_hba.conf", "the server does not let this user or computer in", "add a line for it to pg_hba.conf there"),
    ("has expired", _CERTIFICATE, "renew it on the server, or set the clock of this computer"),
    ("is not yet valid", _CERTIFICATE, "set the clock of this computer"),
    ("client certificate", "the server asks for a certificate of ours", "name it in the address: sslcert=…&sslkey=…"),
    ("root certificate file", "the file of its authority is missing", "name it in the address: sslrootcert=FILE"),
    ("match host name", _CERTIFICATE, "use a name of the certificate; hostaddr=… has the place then"),
    ("certificate", _CERTIFICATE, "name the file of its authority in the address: sslrootcert=FILE"),
    ("not support SSL", "it has no TLS, and the address asks for it", "set ssl = on there, or change sslmode"),
    ("too many", _FULL, _SESSIONS),
    ("connection slots", _FULL, _SESSIONS),
    ('" does not exist', "its user or its database does not exist", "`createuser USER`, `createdb -E UTF8 DATABASE`"),
    ("permission denied", "its user may not connect", "`GRANT CONNECT ON DATABASE … TO …`"),
    ("read-only", _READS, _PRIMARY),
    ("hot standby", _READS, _PRIMARY),
)

# By the first characters of SQLSTATE (PostgreSQL 18, appendix A); the longest that matches counts.
_STATES = {
    "22": ("a value cannot be stored", "report it: no value of a fleet is so"),
    "22023": ("the server refuses a setting of the session", "look at its log: its own files may be missing"),
    "23": ("a record contradicts another one", BRING_BACK_DATABASE),
    "25006": (_READS, _PRIMARY),
    "3F": ("the schema of this fleet is missing", BRING_BACK_DATABASE),
    "40": (_BUSY, "try again"),
    "42501": ("its user may not do that", "grant it the database: `GRANT CREATE ON DATABASE … TO …`"),
    "42703": ("a column is missing: a table was changed by hand", BRING_BACK_DATABASE),
    "42P01": ("a table is missing: the schema was changed by hand", BRING_BACK_DATABASE),
    "53100": ("the disk of the database is full", _SPACE),
    "53200": ("the server has no memory left", "look at what else runs there"),
    "53300": (_FULL, _SESSIONS),
    "55P03": (_BUSY, "try again"),
    "57P03": ("the server is starting or shutting down", "wait until it is up"),
    "58": ("the disk of the database fails", "look at the log of the server, and at its disk"),
    "XX001": ("the database is damaged", BRING_BACK_DATABASE),
    "XX002": ("an index of the database is damaged", "rebuild it: `reindexdb`"),
}


def make_refused_error(name: str, error: Exception, conninfo: str) -> JournalError:
    """The error for a connection that was refused, or not answered."""
    text = _flatten(error)
    if reason := find_certificate_reason(conninfo, text):
        text = f"failed: {reason}"
    for pattern, problem, remedy in _REFUSED:
        if pattern in text:
            return JournalError(f"{name}: {problem} ({_find_reason(text)})", remedy)
    return ConnectionLost(f"{name}: the database cannot be reached ({_find_reason(text)})", _SERVER)


def make_failed_error(name: str, error: Exception) -> JournalError:
    """The error for a statement that failed, on a connection that goes on."""
    state = (error.sqlstate if isinstance(error, psycopg.Error) else None) or "22"
    key = max((key for key in _STATES if state.startswith(key)), key=len, default="")
    problem, remedy = _STATES.get(key, ("the journal cannot be used", "look at the log of its server"))
    return JournalError(f"{name}: {problem} ({_flatten(error).partition(' LINE 1')[0]})", remedy)


def make_lost_error(name: str) -> ConnectionLost:
    """The error for a connection that ended."""
    return ConnectionLost(f"{name}: the connection was lost, and nothing of it was stored", _SERVER)


def make_late_error(name: str, deadline_s: float) -> AnswerLate:
    """The error for a connection that was closed because no answer came in time."""
    text = f"{name}: no answer within {deadline_s:g} s; the connection was closed, and nothing of it was stored"
    return AnswerLate(text, _SERVER)


def _flatten(error: Exception) -> str:
    return " ".join(str(error).split())


def _find_reason(text: str) -> str:
    """What is said of the first host, behind the words of libpq about the place."""
    return text.partition(" Multiple connection attempts failed")[0].rpartition("failed: ")[2].removeprefix("FATAL: ")
