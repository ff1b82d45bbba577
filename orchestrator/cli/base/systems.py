"""What some operating systems cannot have: a fleet runs on Linux, its clients also on Windows and macOS."""

import sys

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.errors import exit_with_error

_NAMES = {"linux": "Linux", "darwin": "macOS", "win32": "Windows"}
ON_ITS_COMPUTER = "run it on the computer of the fleet; commands with --connect work from here"


def require_linux(what: str, remedy: str = ON_ITS_COMPUTER) -> None:
    """End the command on another system. what: cannot be had there."""
    _require_one_of(("linux",), what, remedy)


def require_unix(what: str, remedy: str) -> None:
    """End the command on Windows. what: cannot be had there."""
    _require_one_of(("linux", "darwin"), what, remedy)


def _require_one_of(systems: tuple[str, ...], what: str, remedy: str) -> None:
    if sys.platform not in systems:
        names = " and ".join(_NAMES[system] for system in systems)
        text = f"{what} can be had on {names} only, and this is {_NAMES.get(sys.platform, sys.platform)}"
        exit_with_error(text, BAD_INPUT, remedy, code="other-system")
