"""The addresses on which no other machine can reach this one."""

from orchestrator.model.errors import Refusal

OWN_ADDRESSES = ("127.0.0.1", "localhost", "::1")


def require_own_address(address: str) -> None:
    """Raises `Refusal`, code `not-own-address`, for an address on which other machines could reach the page."""
    if address not in OWN_ADDRESSES:
        text = f"the page is not served on {address[:100]}, but on {', '.join(OWN_ADDRESSES)} only: the fleet has no "
        text += "keys by which it knows other machines"
        remedy = "serve it on 127.0.0.1; from another machine reach it by `ssh -L 8080:127.0.0.1:8080`"
        raise Refusal("not-own-address", text, remedy)
