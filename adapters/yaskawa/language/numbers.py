"""Numbers in replies: the only place where text from the wire becomes a number.

The controller's numbers have 32 bits before the point and 16 after it (L15710), printed with at most four decimals; and
a sum in units of 1/65536 is printed with ten digits. Anything else is garbage: `inf`, `nan`, exponents, hexadecimal.
"""

import re

from orchestrator.model.errors import ControllerFault

_NUMBER = re.compile(r"[+-]?[0-9]{1,10}(?:\.[0-9]{0,4})?")
_ERROR_CODE = re.compile(r"([0-9]{1,3})(?: .*)?")
_BLOCK_SIZE = re.compile(r"[0-9]{1,3}")


def parse_numbers(line: str, count: int, command: str) -> list[float]:
    """Parse `count` numbers between commas; blanks for positive signs are allowed. Raises `ControllerFault`."""
    fields = [field.replace(" ", "") for field in line.split(",")]
    if len(fields) != count or not all(map(_NUMBER.fullmatch, fields)):
        raise ControllerFault(
            "garbage",
            f"after {command!r} expected {count} numbers with commas between them, got {line[:200]!r}",
            "check the cable; does another program print on this handle?",
        )
    return [float(field) for field in fields]


def parse_error_code(words: str) -> int | None:
    """Return the code of the reply to TC1 (L10254); None for anything else."""
    code_match = _ERROR_CODE.fullmatch(words)
    return None if code_match is None else int(code_match[1])


def parse_sizes(line: str) -> list[int]:
    """Return the whole numbers of up to three digits between commas; other fields are left out."""
    return [int(field) for field in map(str.strip, line.split(",")) if _BLOCK_SIZE.fullmatch(field)]
