"""The words of a line: a letter and a number, which may be an expression."""

import re
from collections.abc import Iterator, Sequence
from typing import NamedTuple

from orchestrator.model.paths.files.gcode.errors import LineError
from orchestrator.model.paths.files.gcode.expressions import Calculator, ExpressionReader

LARGEST = 1e9  # of the number of a word
LONGEST = 10_000  # characters of a line

_WORD = re.compile(r"\s*([A-Za-z])\s*([-+]?(?:\d+\.?\d*|\.\d+))", re.ASCII)
_COMMENT = re.compile(r"\([^()]*\)|;.*")
_CHECKSUM = re.compile(r"\*\s*(\d{1,3})\s*$", re.ASCII)
_DIFFICULT = re.compile(r"[#\[]")


class Word(NamedTuple):
    """A letter with its number. column: where it begins, from 1. has_point: whether the number has a decimal point."""

    letter: str
    value: float
    column: int
    has_point: bool = True

    @property
    def name(self) -> str:
        """As it is written: G61.1."""
        return f"{self.letter}{self.value:g}"


class BareLine(NamedTuple):
    """A line without comments, each of which is spaces of its length. text: what is left; is_deleted: it begins with a
    slash; has_checksum: it ended with one."""

    text: str
    is_deleted: bool = False
    has_checksum: bool = False


def strip_line(text: str) -> BareLine:
    """The line without its comments, slash and checksum. Raises `LineError`."""
    if len(text) > LONGEST:
        raise LineError(0, f"the line has {len(text)} characters; the maximum is {LONGEST}")
    bare = text
    if "(" in text or ";" in text:
        bare = _COMMENT.sub(lambda match: " " * len(match.group()), text)
    has_checksum = False
    if "*" in bare and "[" not in bare and (match := _CHECKSUM.search(bare)) is not None:
        _compare_checksum(text, match)
        bare, has_checksum = bare[: match.start()], True
    start = bare.lstrip()
    if start.startswith("/"):
        return BareLine(bare.replace("/", " ", 1), is_deleted=True, has_checksum=has_checksum)
    return BareLine(bare, has_checksum=has_checksum)


def _compare_checksum(text: str, match: re.Match[str]) -> None:
    """A checksum is the exclusive or of the bytes of the line before its star."""
    total = 0
    for byte in text[: match.start()].encode():
        total ^= byte
    if total != int(match[1]):
        raise LineError(match.start() + 1, f"the checksum of the line is {total}, not {match[1]}: the file was damaged")


def read_words(text: str, calculator: Calculator | None) -> Sequence[Word]:
    """The words of a bare line. Parameters that it sets have their values behind it.

    calculator: None: a dialect without expressions. Raises `LineError`.
    """
    if calculator is not None and _DIFFICULT.search(text) is not None:
        return _read_difficult(text, calculator)
    words: list[Word] = []
    at, end = 0, len(text.rstrip())
    match_word = _WORD.match
    while at < end:
        match = match_word(text, at, end)
        if match is None:
            raise _make_error(text, at)
        letter, number = match.groups()
        value = float(number)
        if not -LARGEST <= value <= LARGEST:
            raise LineError(match.start(1) + 1, f"{letter.upper()}{value:g} is beyond {LARGEST:g}")
        words.append(Word(letter.upper(), value, match.start(1) + 1, "." in number))
        at = match.end()
    return words


def _make_error(text: str, at: int) -> LineError:
    begin = at + len(text[at:]) - len(text[at:].lstrip())
    return LineError(begin + 1, f"{text[begin : begin + 20]!r} is no word of a letter and a number")


def _read_difficult(text: str, calculator: Calculator) -> list[Word]:
    reader = ExpressionReader(text, calculator)
    words: list[Word] = []
    settings: list[tuple[int | str, float]] = []
    for begin, letter in _split_words(reader):
        if letter == "#":
            settings.append(reader.read_setting())
            continue
        value, has_point = reader.read_value()
        if not -LARGEST <= value <= LARGEST:
            raise LineError(begin + 1, f"{letter}{value:g} is beyond {LARGEST:g}")
        words.append(Word(letter, value, begin + 1, has_point))
    for name, value in settings:
        calculator.set_parameter(name, value)
    return words


def _split_words(reader: ExpressionReader) -> Iterator[tuple[int, str]]:
    """The place and the letter of each word, or # of a setting; what reads them reads on behind it."""
    while not reader.is_at_end:
        begin, sign = reader.at, reader.peek().upper()
        if sign != "#" and not ("A" <= sign <= "Z"):
            raise _make_error(reader.text, begin)
        reader.at += 1
        yield begin, sign
