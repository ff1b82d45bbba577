"""Log lines to the journal of systemd, with the fields of each line as fields there (`systemd.journal-fields(7)`).

`journalctl TUTTI_JOB=f9fd070e` then shows what all processes of a computer say about a job.
"""

import json
import os
import socket
import sys
from collections.abc import Mapping
from contextlib import suppress
from typing import Any

SOCKET = "/run/systemd/journal/socket"
WANTED = "journal"
"""Value of the environment variable TUTTI_LOG."""

_PRIORITIES = {"error": 3, "warning": 4, "info": 6}


class JournalSender:
    """Sends lines by the journal's native protocol. What it does not take is lost there; the log file has it."""

    def __init__(self, path: str = SOCKET) -> None:
        self._path = path
        self._socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_NONBLOCK)

    def send_line(self, line: str) -> None:
        """Send a JSON line. Raises nothing."""
        with suppress(OSError, ValueError):
            self._socket.sendto(encode_fields(json.loads(line)), self._path)

    def close(self) -> None:
        self._socket.close()


def encode_fields(entry: Mapping[str, Any]) -> bytes:
    """The fields of a log line: `text` is the message, others have the prefix `TUTTI_`."""
    fields = {"MESSAGE": str(entry.get("text", "")), "PRIORITY": str(_PRIORITIES.get(str(entry.get("level")), 6))}
    fields["SYSLOG_IDENTIFIER"] = "tutti"
    for name, value in entry.items():
        if name not in ("text", "level") and value is not None:
            text = value if isinstance(value, str) else json.dumps(value)
            fields[f"TUTTI_{_make_name(name)}"] = text
    return b"".join(_encode_field(name, value) for name, value in fields.items())


def is_wanted(environment: Mapping[str, str] = os.environ) -> bool:
    """Whether lines go to the journal, too. Only Linux has it."""
    return sys.platform == "linux" and environment.get("TUTTI_LOG") == WANTED


def _make_name(name: str) -> str:
    return "".join(character if character.isascii() and character.isalnum() else "_" for character in name.upper())[:50]


def _encode_field(name: str, value: str) -> bytes:
    data = value.encode("utf-8", "replace")
    if b"\n" not in data:
        return name.encode() + b"=" + data + b"\n"
    return name.encode() + b"\n" + len(data).to_bytes(8, "little") + data + b"\n"
