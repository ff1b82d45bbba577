"""The database of a journal, as a coordinator would find it."""

from orchestrator.coordinator.journal.postgres.address import read_address
from orchestrator.coordinator.journal.postgres.health import read_health
from orchestrator.coordinator.journal.postgres.journal import FleetDatabase, open_session
from orchestrator.coordinator.journal.postgres.names import TOOL
from orchestrator.coordinator.journal.records import JournalError
from orchestrator.model.queue import JournalPolicy
from orchestrator.runtime.doctor.findings import Finding

CHECK = "journal"


def check_journal_server(address: str, fleet: str, policy: JournalPolicy) -> list[Finding]:
    """Connect to the database of a fleet's journal, and look at what it promises. policy: of the fleet file."""
    try:
        database = FleetDatabase(read_address(address), fleet, policy.copies)
        session = open_session(database, TOOL)
    except JournalError as error:
        return [Finding(CHECK, "failed", error.text, error.remedy)]
    try:
        health = read_health(session, policy.copies)
    except JournalError as error:
        return [Finding(CHECK, "failed", error.text, error.remedy)]
    finally:
        session.close()
    is_short = health.mode == "waits for a copy"
    text = f"{database.address.text}: PostgreSQL {health.version}, timeline {health.timeline}; {health.mode}"
    if is_short:
        text += ", and no job is accepted"
    state = "failed" if is_short else "ok"
    findings = [Finding(CHECK, state, text, "" if not is_short else "see what follows")]
    kind = "failed" if is_short or health.in_recovery else "warning"
    return findings + [Finding(CHECK, kind, problem.text, problem.remedy) for problem in health.problems]
