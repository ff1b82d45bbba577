"""The tables of records, and their columns: the same in each database, and in an export of this schema."""

RECORD_SCHEMA = 14
"""The schema of exports. It counts up with each change of a table here; SQLite's own number is the same."""

RECORDS: dict[str, tuple[str, ...]] = {
    "meta": ("key", "value"),
    "jobs": (
        *("number", "id", "client_key", "name", "actor", "body", "state", "reason", "submitted_utc"),
        *("priority", "place", "repeat", "after_job", "at_utc", "missed", "due", "held_by", "origin", "from_step"),
        *("expires_utc", "now", "session", "crc", "proposed", "request_digest", "continues"),
    ),
    "transitions": ("job_id", "state", "reason", "actor", "utc", "fleet_ns"),
    "decisions": ("job_id", "step", "epoch", "t0_fleet_ns", "members", "utc"),
    "reports": ("job_id", "body"),
    "recordings": ("job_id", "step", "body"),
    "reservations": ("holder", "actor", "what", "axes", "until_utc"),
    "meta_copies": ("key", "value", "crc"),
    "job_points": ("job_id", "digest"),
    "point_rows": (
        *("job_id", "step", "point", "state", "verdict", "t0_fleet_ns", "skew_least_ns", "skew_most_ns", "took_s"),
        *("target", "measured", "flown"),
    ),
    "positions": ("name", "body", "crc"),
    "alarms": ("id", "body", "crc"),
    "alarm_history": ("number", "body"),
    "alarm_notices": ("change", "body", "crc", "tries"),
    "statistics": ("day", "kind", "subject", "figure", "value"),
    "approvals": ("job_id", "body", "crc"),
    "commands": ("number", "utc", "actor", "verb", "subject", "refused"),
    "learned": ("controller", "body", "crc"),
}
"""In the order in which they are filled: a record comes after those that it names."""

POINTS: dict[str, tuple[str, ...]] = {
    "uploads": ("digest", "header", "size", "received", "columns", "used_utc"),
    "parts": ("digest", "begin", "data", "crc"),
}
"""Those of the points of scans."""

IN_ORDER = ("transitions", "decisions", "reservations", "alarm_notices")
"""Tables whose rows have an order, and no number of their own."""
