"""Names of a fleet in a database: its schema, and its sessions.

PostgreSQL cuts names after 63 bytes. A long name of a fleet is shortened, with a checksum of the whole.
"""

from zlib import crc32

_LONGEST = 40  # characters of a fleet's name; its epoch follows in the name of a session
STANDBY = "standby"
TOOL = "tool"


def name_schema(fleet: str) -> str:
    """The schema of a fleet: several fleets in one database do not see each other."""
    return f"tutti_{_shorten(fleet)}"


def name_session(fleet: str, role: str) -> str:
    """`application_name` of a session. role: the epoch of a leader, else `STANDBY` or `TOOL`."""
    return f"tutti {_shorten(fleet)} {role}"


def make_leader_pattern(fleet: str) -> str:
    """The regular expression of the names of leaders' sessions. A name of a fleet has no character that is special
    there."""
    return f"^tutti {_shorten(fleet)} [0-9]+$"


def _shorten(fleet: str) -> str:
    if len(fleet) <= _LONGEST:
        return fleet
    return f"{fleet[: _LONGEST - 9]}_{crc32(fleet.encode()):08x}"
