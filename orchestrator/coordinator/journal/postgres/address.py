"""The address of a database: `postgresql://user@host,host/database?option=value`."""

from typing import NamedTuple

import psycopg
from psycopg.conninfo import conninfo_to_dict, make_conninfo

from orchestrator.coordinator.journal.records import JournalError

CONNECT_S = 2  # to each host; libpq takes no less
_FORM = "write it as `postgresql://USER@HOST,HOST/DATABASE`, and the password into ~/.pgpass"


class JournalAddress(NamedTuple):
    """A database that can be connected to. text: without the password, for messages."""

    conninfo: str
    text: str


def read_address(address: str) -> JournalAddress:
    """Read an address. Raises `JournalError`."""
    try:
        parts = conninfo_to_dict(address)
    except psycopg.Error as error:
        problem = " ".join(str(error).split())
        raise JournalError(f"it is no address of a PostgreSQL database: {_hide(problem, address)}", _FORM) from None
    if not address.startswith(("postgresql://", "postgres://")) or not parts.get("dbname"):
        raise JournalError("it is no address of a PostgreSQL database: its scheme or its database is missing", _FORM)
    hosts = str(parts.get("host") or parts.get("hostaddr") or "the local socket").split(",")
    ports = str(parts.get("port") or "").split(",")
    if not all(port.isdecimal() for port in ports if port) or len(ports) not in (1, len(hosts)):
        raise JournalError(f"it is no address of a PostgreSQL database: its port is {','.join(ports)!r}", _FORM)
    settings = {
        "connect_timeout": CONNECT_S,
        "target_session_attrs": "read-write",
        "tcp_user_timeout": CONNECT_S * 1000,
        **parts,
        "client_encoding": "UTF8",
    }
    ports = ports if len(ports) == len(hosts) else ports * len(hosts)
    places = ",".join(f"{host}:{port}" if port else host for host, port in zip(hosts, ports, strict=True))
    user = f"{parts['user']}@" if parts.get("user") else ""
    return JournalAddress(make_conninfo("", **settings), f"postgresql://{user}{places}/{parts['dbname']}")


def _hide(problem: str, address: str) -> str:
    """libpq quotes an address that it cannot read, with its password."""
    return problem.replace(address, "…") if address in problem else problem.partition('"')[0].rstrip(": ")
