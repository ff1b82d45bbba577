"""Addresses on which other machines can, and cannot, reach this one."""

import ipaddress

from orchestrator.model.errors import Refusal


def require_own_address(address: str) -> None:
    """Raises `Refusal`, code `not-own-address`, for an address on which other machines could reach the page."""
    try:
        is_own = address == "localhost" or ipaddress.ip_address(address).is_loopback
    except ValueError:
        is_own = False
    if not is_own:
        text = f"the page is not served on {address[:100]}: other machines could reach it there, and the fleet has no "
        text += "keys by which it knows them"
        remedy = "serve it on 127.0.0.1; from another machine reach it by `ssh -L 8080:127.0.0.1:8080`"
        raise Refusal("not-own-address", text, remedy)
