"""What a package needs to add a command to `tutti`, by an entry point of the group `tutti.commands`.

    [project.entry-points."tutti.commands"]
    acme = "acme_tutti.command:acme"

Its options, errors and exit codes are those of all commands. It is loaded for `tutti --help`: a module of a command
imports this module and `click`, and everything else inside the command.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

from orchestrator.cli.base.codes import BAD_INPUT, FAILED, INTERRUPTED, UNREACHABLE
from orchestrator.cli.base.common import (
    actor_name,
    console,
    fleet_options,
    json_option,
    print_json,
    print_result,
    with_fleet,
)
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.extras import require_extra
from orchestrator.cli.base.interfaces import interface_option, is_loopback

if TYPE_CHECKING:
    from orchestrator.cli.base.serving import ServerReady, serve_fleet

__all__ = [
    "BAD_INPUT",
    "FAILED",
    "INTERRUPTED",
    "UNREACHABLE",
    "ServerReady",
    "actor_name",
    "console",
    "exit_with_error",
    "fleet_options",
    "interface_option",
    "is_loopback",
    "json_option",
    "print_json",
    "print_result",
    "require_extra",
    "serve_fleet",
    "with_fleet",
]


def __getattr__(name: str) -> Any:
    """What needs a connection is imported when it is used."""
    if name in ("ServerReady", "serve_fleet"):
        return getattr(import_module("orchestrator.cli.base.serving"), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
