"""The address at which a server of a command serves."""

from ipaddress import ip_address

import click

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.errors import exit_with_error

interface_option = click.option(
    "--interface", default="127.0.0.1", show_default=True, help="The address at which it serves."
)


def is_loopback(interface: str) -> bool:
    """Whether only this computer reaches an address; what is no address ends the command."""
    try:
        return ip_address(interface).is_loopback
    except ValueError:
        text = f"--interface: {interface} is not an address"
        exit_with_error(text, BAD_INPUT, "write one of this computer's, e.g. 127.0.0.1")
