"""The table of limits states what the code has."""

from pathlib import Path

import pytest

from adapters.controller.publishing.tracing import MAX_TRACE_PART_BYTES
from orchestrator.bus import answers, budgets, limits, log, logfile
from orchestrator.clock import executor
from orchestrator.clock.base import NS_PER_S
from orchestrator.coordinator.command_log import MAX_SUBJECT
from orchestrator.coordinator.jobs.intake.approval import MAX_SHOWN
from orchestrator.coordinator.jobs.queue.publisher import MAX_PUBLISHED_JOBS
from orchestrator.coordinator.jobs.queue.queue_order import MAX_JOBS_WITHOUT_AXES
from orchestrator.coordinator.journal.sql.command_table import MAX_COMMANDS
from orchestrator.coordinator.journal.sql.job_changes import MAX_RECORDED_JOBS, MAX_RECORDED_STEPS
from orchestrator.coordinator.journal.sql.point_store import QUOTA_BYTES
from orchestrator.coordinator.motion.recorder import MAX_SAMPLES
from orchestrator.gateway import (
    app,
    bodies,
    commands,
    connections,
    fleet_files,
    guard,
    job_files,
    open_stops,
    preview,
    reads,
    server,
)
from orchestrator.gateway.access import authentication, sign_in_limits, users
from orchestrator.gateway.stream import acts, counts, fleet_state, job_table, messages, need, socket
from orchestrator.link.trace import MAX_TRACE_ENTRIES
from orchestrator.model.base import MAX_RATIONAL_LENGTH
from orchestrator.model.files.yaml_reader import MAX_BYTES
from orchestrator.model.messages import MAX_TRACE_PART
from orchestrator.model.queue import MAX_FLAT_STEPS, MAX_STEPS
from orchestrator.model.steps.points import MAX_LISTED, MAX_POINTS, MAX_SCAN_AXES
from orchestrator.model.steps.repeat import MAX_REPEAT_DEPTH, MAX_REPEATED
from orchestrator.model.steps.scan import MAX_AT_EACH

PAGE = (Path(__file__).parents[3] / "docs" / "reference" / "limits.md").read_text(encoding="utf-8")
ROWS = {
    "message on the bus": [limits.MAX_MESSAGE_BYTES],
    "message in a coordinator": [limits.MAX_COORDINATOR_MESSAGE_BYTES, limits.MAX_HOST_MESSAGE_BYTES],
    "fields, values": [budgets.USUAL.max_fields],
    "large requests": [executor.MAX_CALLS, executor.READING.call_s],
    "check, dry run and plan of a path": [executor.CHECKING.call_s, executor.PLANNING.call_s],
    "messages that wait": [
        limits.MAX_STATES_QUEUED,
        limits.MAX_CALLS_QUEUED,
        limits.MAX_ESTOPS_QUEUED,
        limits.MAX_BYTES_QUEUED,
    ],
    "requests that a process answers": [limits.MAX_ANSWERING],
    "answers that are kept": [answers.MAX_ANSWERS],
    "numbers that are read": [MAX_RATIONAL_LENGTH],
    "fleet or job file": [MAX_BYTES],
    "steps of a job": [MAX_STEPS],
    "points or values": [MAX_LISTED, MAX_SCAN_AXES, MAX_AT_EACH],
    "steps inside a repeat": [MAX_REPEATED, MAX_REPEAT_DEPTH],
    "points of scans that are stored": [QUOTA_BYTES],
    "commands of users": [MAX_COMMANDS, MAX_SUBJECT],
    "plans that a coordinator": [MAX_SHOWN],
    "jobs without axes": [MAX_JOBS_WITHOUT_AXES],
    "jobs in the published queue": [MAX_PUBLISHED_JOBS],
    "samples of an axis": [MAX_SAMPLES, MAX_RECORDED_STEPS, MAX_RECORDED_JOBS],
    "lines of one source": [log.MAX_LINES_PER_S, log.MAX_LINE_CHARS],
    "bytes on a link": [MAX_TRACE_ENTRIES, MAX_TRACE_PART, MAX_TRACE_PART_BYTES],
    "warnings of one source": [log.MAX_PUBLISHED_PER_S],
    "log file": [logfile.MAX_LOG_BYTES, logfile.KEPT_LOGS],
    "sockets of the gateway": [app.MAX_SOCKETS],
    "connections of requests": [connections.MAX_CONNECTIONS, connections.STOP_RESERVE],
    "connections of an address": [connections.MAX_NOT_SIGNED_IN],
    "body of a request": [bodies.MAX_BODY_BYTES, guard.MAX_HEADER_BYTES],
    "body of a request that is not signed in": [bodies.MAX_UNPROVEN_BYTES, int(bodies.BODY_S)],
    "time for the head": [int(server.HEAD_S)],
    "pace of a body": [int(bodies.BODY_S), bodies.LEAST_BYTES_PER_S // 1000, int(bodies.LONGEST_BODY_S)],
    "bodies of all requests": [bodies.MAX_BODIES_BYTES],
    "a frame from a page": [socket.MAX_FRAME_CHARS],
    "frames of a socket": [socket.MAX_FRAMES_PER_S],
    "answers that wait for a slow reader": [socket.MAX_WAITING, int(socket.SEND_S)],
    "axes under manual control of a socket": [acts.MAX_AXES],
    "sessions; from the last request": [
        authentication.MAX_SESSIONS,
        authentication.SESSION_NS // 3600 // NS_PER_S,
        authentication.LONGEST_SESSION_NS // 24 // 3600 // NS_PER_S,
    ],
    "users; tokens of each": [users.MAX_USERS, users.MAX_TOKENS],
    "characters of a password": [users.MIN_PASSWORD, users.MAX_PASSWORD],
    "failed sign-ins": [
        sign_in_limits.FREE_FAILURES,
        sign_in_limits.FIRST_PAUSE_NS // NS_PER_S,
        sign_in_limits.LONGEST_PAUSE_NS // NS_PER_S,
        sign_in_limits.FORGET_NS // NS_PER_S,
    ],
    "stops that are not signed in": [open_stops.STOPS_PER_S],
    "passwords that are verified": [
        sign_in_limits.MAX_VERIFYING,
        sign_in_limits.MAX_UNKNOWN_VERIFYING,
        sign_in_limits.MAX_ADDRESS_VERIFYING,
    ],
    "users with an address": [sign_in_limits.MAX_FAILED],
    "idempotency keys": [commands.MAX_KEYS, app.MAX_KEY],
    "in the state": [
        fleet_state.MAX_CONTROLLERS,
        job_table.MAX_JOBS,
        messages.MAX_ALARMS,
        fleet_state.MAX_LEASES,
        messages.MAX_EVENTS,
    ],
    "items of a `need`": [need.MAX_ITEMS, counts.MAX_TROUBLED],
    "templates": [job_files.MAX_TEMPLATES, reads.MAX_RECORDINGS, reads.MAX_TRACE_FRAMES],
    "steps that are drawn": [preview.MAX_STEPS, preview.MAX_POINTS],
    "steps of a job that is forecast": [job_files.MAX_DRY_RUN_STEPS],
    "changes of a fleet file": [fleet_files.MAX_CHANGES],
}


def test_the_numbers_of_points_are_those_of_the_code() -> None:
    assert f"| {MAX_POINTS:,}, {MAX_FLAT_STEPS:,} |" in PAGE


@pytest.mark.parametrize("row", ROWS)
def test_a_row_has_the_values_of_the_code(row: str) -> None:
    line = next(line for line in PAGE.splitlines() if line.startswith(f"| {row}"))
    limit = line.split("|")[2]
    for value in ROWS[row]:
        shown = f"{value // 1_000_000} MB" if value >= 1_000_000 else f"{value:,}"
        assert shown in limit, line
