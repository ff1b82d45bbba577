"""What a database promises: how many machines have what was committed, and what is wrong with its settings."""

from datetime import UTC, datetime
from typing import NamedTuple

from orchestrator.coordinator.journal.postgres.session import Session, Statement
from orchestrator.model.queue import CopyMode

MOST_CLOCK_S = 1.0  # between this computer's clock and the server's

_READ = Statement(
    "SELECT current_setting('server_version'), current_setting('fsync'), current_setting('synchronous_commit'),"
    " (SELECT reset_val FROM pg_settings WHERE name = 'synchronous_commit'), pg_is_in_recovery(),"
    " current_setting('synchronous_standby_names'), (SELECT system_identifier::text FROM pg_control_system()),"
    " CASE WHEN pg_is_in_recovery() THEN '' ELSE pg_walfile_name(pg_current_wal_lsn()) END,"
    " extract(epoch FROM clock_timestamp())::double precision, pg_has_role('pg_monitor', 'usage')"
)
_READ_STANDBYS = (
    "SELECT application_name, sync_state IN ('sync', 'quorum') AND state = 'streaming'"
    " AND flush_lsn >= CAST(? AS pg_lsn) FROM pg_stat_replication ORDER BY 1"
)
BEGINNING = "0/0"  # of the log


class HealthProblem(NamedTuple):
    """Something that a site has to change."""

    text: str
    remedy: str


class JournalHealth(NamedTuple):
    """What a database says of itself.

    server_commit: `synchronous_commit` as the server gives it to a session; session_commit: as this one has it.
    standbys: those that confirm commits, and have those of before. followers: all that copy from it. timeline: counts
    up with each promotion; 0 in recovery. system: the same for a primary and its standbys. clock_s: the server's clock,
    less this computer's.
    """

    version: str
    fsync: bool
    server_commit: str
    session_commit: str
    in_recovery: bool
    standby_names: str
    standbys: tuple[str, ...]
    followers: tuple[str, ...]
    timeline: int
    system: str
    clock_s: float
    mode: CopyMode
    problems: tuple[HealthProblem, ...]

    @property
    def may_lose_jobs(self) -> bool:
        """Whether one of its standbys may be promoted that has not all jobs that were accepted."""
        return self.mode == "one copy" and bool(self.followers)


def read_health(session: Session, copies: int, awaited: str = BEGINNING) -> JournalHealth:
    """Ask the server. copies: the machines that the fleet asks for. awaited: the place in the log that a standby must
    have to count; one that hangs stays connected for a minute. Raises `JournalError`."""
    sent_s = datetime.now(UTC).timestamp()
    rows, standby_rows = session.run_again([_READ, Statement(_READ_STANDBYS, (awaited,))])
    clock_s = rows[0][8] - (sent_s + datetime.now(UTC).timestamp()) / 2
    version, fsync, session_commit, server_commit, in_recovery, names, system, wal, _, is_monitor = rows[0]
    standbys = tuple(name for name, counts in standby_rows if counts)
    health = JournalHealth(
        version=version,
        fsync=fsync == "on",
        server_commit=server_commit,
        session_commit=session_commit,
        in_recovery=in_recovery,
        standby_names=names,
        standbys=standbys,
        followers=tuple(name for name, _ in standby_rows),
        timeline=int(wal[:8], 16) if wal else 0,
        system=system,
        clock_s=clock_s,
        mode=_find_mode(copies, session_commit, names, standbys),
        problems=(),
    )
    return health._replace(problems=tuple(_find_problems(health, copies, may_monitor=is_monitor)))


def _find_mode(copies: int, session_commit: str, names: str, standbys: tuple[str, ...]) -> CopyMode:
    if copies > 1:
        return "two copies" if names and standbys and session_commit != "local" else "waits for a copy"
    return "one copy"


def _find_problems(health: JournalHealth, copies: int, *, may_monitor: bool) -> list[HealthProblem]:
    problems: list[HealthProblem] = []
    if health.in_recovery:
        text = "the server is a standby, and takes no writes"
        problems.append(HealthProblem(text, "name the primary in the address, or promote this one"))
    if not health.fsync:
        text = "fsync is off: what was accepted is lost when the server's machine loses its power"
        problems.append(HealthProblem(text, "set fsync = on there"))
    if health.server_commit in ("off", "local", "remote_write"):
        text = f"synchronous_commit is {health.server_commit} for sessions that set nothing; the journal's own set it"
        problems.append(HealthProblem(text, "set synchronous_commit = on there, and see what else has changed"))
    if abs(health.clock_s) > MOST_CLOCK_S:
        text = f"the server's clock is {health.clock_s:+.1f} s off this computer's"
        problems.append(HealthProblem(text, "let both follow the same time server"))
    if copies > 1 and not may_monitor:
        text = "its user may not see the standbys: every copy counts as missing"
        problems.append(HealthProblem(text, "`GRANT pg_monitor TO USER` there"))
    elif copies > 1 and not health.standby_names:
        text = "commits wait for no copy: synchronous_standby_names is empty"
        problems.append(HealthProblem(text, "name the standby in synchronous_standby_names"))
    elif copies > 1 and not health.standbys:
        text = f"no standby of synchronous_standby_names = '{health.standby_names}' follows: commits wait for it"
        remedy = "start the standby; after a promotion: `ALTER SYSTEM RESET synchronous_standby_names`, and reload"
        problems.append(HealthProblem(text, remedy))
    return problems
