"""One line: its codes by modal group, its words by letter, and what each word is for. No word is dropped."""

from collections.abc import Mapping, Sequence

from orchestrator.model.paths.files.gcode.codes import CYCLES, Code, Dialect, explain_refusal, find_code
from orchestrator.model.paths.files.gcode.errors import LineError
from orchestrator.model.paths.files.gcode.words import Word

LETTERS = "XYZABCUVW"
_KNOWN = frozenset(f"{LETTERS}DEFHIJKLPQRST")
_OF_COORDINATES = frozenset(f"{LETTERS}IJKQR")


class CodeLine:
    """The words of a line. Each is taken for one meaning; what is left over is refused.

    codes: by group, with the word of each. Raises `LineError` for what no line may have.
    """

    def __init__(self, words: Sequence[Word], dialect: Dialect) -> None:
        self.codes: dict[str, tuple[Code, Word]] = {}
        self._values: dict[str, Word] = {}
        self._meanings: dict[str, str] = {}
        for word in words:
            letter = word.letter
            if letter in "GM":
                self._add_code(word, dialect)
            elif letter == "N":
                self._meanings["N"] = "the number of the line"
            elif letter == "O" and dialect.name == "fanuc" and len(words) == 1:
                self._meanings["O"] = "the number of the program"
            elif letter not in _KNOWN:
                raise LineError(word.column, f"{word.name} is not supported")
            elif letter in self._values:
                raise LineError(word.column, f"{letter} stands twice in this line")
            else:
                self._check_point(word, dialect)
                self._values[letter] = word
        self._check_pairs()

    def _check_pairs(self) -> None:
        """Refuse codes that exclude each earlier_code though they are of several groups."""
        if "cycle end" in self.codes and self.find_code("motion") in CYCLES:
            text = f"G80 and {self.find_code('motion')} are of one modal group; a line has one of it"
            raise LineError(self.codes["cycle end"][1].column, text)
        if "coolant" in self.codes and ("mist" in self.codes or "flood" in self.codes):
            raise LineError(self.codes["coolant"][1].column, "this line switches the coolant on and off")

    def _add_code(self, word: Word, dialect: Dialect) -> None:
        code = find_code(dialect, word.letter, word.value)
        if code is None:
            raise LineError(word.column, explain_refusal(dialect, word.name))
        earlier_code = self.codes.get(code.group)
        if earlier_code is not None:
            raise LineError(
                word.column, f"{code.name} and {earlier_code[0].name} are of one modal group; a line has one of it"
            )
        self.codes[code.group] = code, word

    def _check_point(self, word: Word, dialect: Dialect) -> None:
        if dialect.is_integer_small and word.letter in _OF_COORDINATES and word.value and not word.has_point:
            text = f"{word.name} has no decimal point: on some controls it is a thousandth; write {word.name}.0"
            raise LineError(word.column, text)

    @property
    def letters(self) -> Mapping[str, Word]:
        """The words by letter, without codes and numbers of lines."""
        return self._values

    def find_code(self, group: str) -> str:
        """The name of the code of a group; empty: the line has none."""
        return self.codes[group][0].name if group in self.codes else ""

    def has_any(self, letters: str | Sequence[str]) -> bool:
        """Whether one of these words is there, and has no meaning yet."""
        return any(letter in self._values and letter not in self._meanings for letter in letters)

    def take(self, letter: str, meaning: str) -> Word | None:
        """Take a word for a meaning; None: it is not there. Raises `LineError` if it has one already."""
        word = self._values.get(letter)
        if word is None:
            return None
        earlier_meaning = self._meanings.get(letter)
        if earlier_meaning is not None:
            raise LineError(
                word.column, f"{letter} would be of {earlier_meaning} and of {meaning}; write them in two lines"
            )
        self._meanings[letter] = meaning
        return word

    def require(self, letter: str, meaning: str, example: str) -> Word:
        """Take a word that must be there. Raises `LineError`."""
        word = self.take(letter, meaning)
        if word is None:
            raise LineError(0, f"{meaning} needs {example}")
        return word

    def take_number(self, letter: str, meaning: str) -> int | None:
        """Take a word that counts, such as the number of a tool; None: it is not there. Raises `LineError`."""
        word = self.take(letter, meaning)
        if word is None:
            return None
        if word.value != int(word.value) or word.value < 0:
            raise LineError(word.column, f"{letter} is a number of a tool, from 0, not {word.value:g}")
        return int(word.value)

    def finish(self) -> None:
        """Raises `LineError` for a word that has no meaning."""
        if len(self._meanings) < len(self._values):
            for letter, word in self._values.items():
                if letter not in self._meanings:
                    raise LineError(word.column, f"{word.name} has no meaning in this line")
