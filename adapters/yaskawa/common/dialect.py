"""What both models read alike: the names of motors, and lines that a person sends."""

from collections.abc import Awaitable, Callable, Sequence

from adapters.contract import CannotDo
from orchestrator.model.fleet import Controller

MAX_LINE = 80  # characters (SMC-4000: L12254; SMC-2000: L13982)


def motor_indices(config: Controller, names: Sequence[str], known: str) -> dict[str, int]:
    """By axis of the fleet file, the index of its motor. names: alphabets of one letter a motor. known: in words.

    Raises `ValueError`.
    """
    motors: dict[str, int] = {}
    for name, axis in config.axes.items():
        letter = axis.motors[0]
        index = max(alphabet.find(letter) for alphabet in names) if len(letter) == 1 else -1
        if index < 0:
            raise ValueError(f"axes.{name}.motors: there is no motor {letter!r}; motors are {known}")
        if index in motors.values():
            raise ValueError(f"axes.{name}.motors: {letter} is the motor of another axis under its other name")
        motors[name] = index
    return motors


async def send_raw(line: str, ask_all: Callable[[str], Awaitable[list[str]]], not_exchanges: Sequence[str]) -> str:
    """The replies to a line, command by command; a refusal is a reply. not_exchanges: beginnings of commands that are
    not answered by a line. Raises `CannotDo` for what is no line of text."""
    text = line.strip()
    if not text.isascii() or not text.isprintable() or len(text) > MAX_LINE:
        raise CannotDo("bad-line", f"a line has at most {MAX_LINE} printable ASCII characters", "shorten it")
    parts = _commands(text)
    if any(part.strip().startswith(tuple(not_exchanges)) for part in parts):
        raise CannotDo("not-by-raw", f"{text[:2]} is no exchange of a line for a line", "use a terminal for it")
    try:
        replies = [await ask_all(part) for part in parts]
    except CannotDo as refusal:
        return f"? {refusal}"
    return "\n".join(each for lines in replies for each in lines)


def _commands(line: str) -> list[str]:
    """The commands of a line: parted by semicolons outside quotes."""
    parts, quoted = [""], False
    for character in line:
        quoted ^= character == '"'
        if character == ";" and not quoted:
            parts.append("")
        else:
            parts[-1] += character
    return parts
