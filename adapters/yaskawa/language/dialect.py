"""Syntax common to both models: the names of motors, and raw command lines."""

from collections.abc import Awaitable, Callable, Sequence

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller

MAX_LINE = 80  # characters (SMC-4000: L12254; SMC-2000: L13982)


def motor_indices(config: Controller, names: Sequence[str]) -> dict[str, int]:
    """Return the motor index of each axis of a checked fleet file. names: alphabets with one letter per motor."""
    motors: dict[str, int] = {}
    for name, axis in config.axes.items():
        index = find_motor(axis.motors[0], names)
        assert index is not None, "checked when the fleet file was loaded"
        motors[name] = index
    return motors


def find_motor(letter: str, names: Sequence[str]) -> int | None:
    """Return the index of a motor by any of its names; None: there is no such motor."""
    index = max(alphabet.find(letter) for alphabet in names) if len(letter) == 1 else -1
    return None if index < 0 else index


async def send_raw(line: str, query_all: Callable[[str], Awaitable[list[str]]], not_exchanges: Sequence[str]) -> str:
    """Send a command line and return the replies to each of its commands; a refusal counts as a reply.

    not_exchanges: beginnings of commands that are not answered by a line. Raises `Refusal` for anything but a line of
    text."""
    text = line.strip()
    if not text.isascii() or not text.isprintable() or len(text) > MAX_LINE:
        raise Refusal("bad-line", f"a command line has at most {MAX_LINE} printable ASCII characters", "shorten it")
    parts = split_commands(text)
    if any(part.strip().startswith(tuple(not_exchanges)) for part in parts):
        raise Refusal("not-by-raw", f"{text[:2]} is not answered by a single line", "use a terminal for this command")
    try:
        replies = [await query_all(part) for part in parts]
    except Refusal as refusal:
        return f"? {refusal}"
    return "\n".join(line for lines in replies for line in lines)


def split_commands(line: str) -> list[str]:
    """Split a command line at semicolons outside quotes."""
    parts, is_quoted = [""], False
    for character in line:
        is_quoted ^= character == '"'
        if character == ";" and not is_quoted:
            parts.append("")
        else:
            parts[-1] += character
    return parts
