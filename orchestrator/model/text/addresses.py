"""Addresses of computers and controllers as people write them."""

import ipaddress
import re

_NUMBERS = re.compile(r"(?:(?:0[xX][0-9a-fA-F]*|\d+)(?:\.|$))+", re.ASCII)  # what inet_aton(3) takes for numbers


def check_host(text: str) -> str:
    """An address as it is written, if every program reads it the same way.

    Raises `ValueError`: `192.168.001.020` is 192.168.1.16 for many, because a leading zero makes a number octal."""
    if text != text.strip() or any(character.isspace() for character in text):
        raise ValueError(f"{text!r} has a space; remove it")
    if ":" in text or not _NUMBERS.fullmatch(text):
        return text
    try:
        return str(ipaddress.IPv4Address(text))
    except ValueError:
        parts = text.split(".")
        if len(parts) == 4 and all(part.isdigit() and int(part) < 256 for part in parts):
            plain = ".".join(str(int(part)) for part in parts)
            raise ValueError(f"{text} has leading zeros, which many programs take for octal; write {plain}") from None
        raise ValueError(f"{text} is no address; write four numbers, e.g. 192.168.1.20, or a name") from None
