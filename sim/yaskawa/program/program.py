"""Program memory: lines, labels, download (L4128-L4180, L12254-L12258)."""

from dataclasses import dataclass, field

from sim.yaskawa.base.data import LONGEST_LINE, MemoryCapacity
from sim.yaskawa.base.errors import CommandError

LABEL_LENGTH = 7


def parse_label(line: str) -> str | None:
    """Return the label that a line defines, without `#`, or None."""
    text = line.lstrip()
    if not text.startswith("#"):
        return None
    return text[1:].partition(";")[0].replace(" ", "")


@dataclass(slots=True)
class StoredProgram:
    """The program in memory; lines are numbered from 0."""

    room: MemoryCapacity
    lines: list[str] = field(default_factory=list[str])
    labels: dict[str, int] = field(default_factory=dict[str, int])

    def clear_lines(self) -> None:
        self.lines.clear()
        self.labels.clear()

    def insert_lines(self, at: int, lines: list[str]) -> None:
        """Insert lines before line `at`; refusals as in `replace_lines`."""
        self.replace_lines(self.lines[:at] + lines + self.lines[at:])

    def replace_lines(self, lines: list[str]) -> None:
        """Replace the program; when refused (60, 61, 62, and 10: L14436), the memory stays unchanged."""
        if any(not line.strip() or "\t" in line for line in lines):
            raise CommandError(10)
        if len(lines) > self.room.lines or any(len(line) > LONGEST_LINE for line in lines):
            raise CommandError(60)
        labels: dict[str, int] = {}
        for number, line in enumerate(lines):
            label = parse_label(line)
            if label is None:
                continue
            if not 1 <= len(label) <= LABEL_LENGTH or not label[0].isalpha() or label in labels:
                raise CommandError(61)
            labels[label] = number
        if len(labels) > self.room.labels:
            raise CommandError(62)
        self.lines, self.labels = lines, labels

    def find_label(self, label: str) -> int:
        """Return the line that defines `label`."""
        number = self.labels.get(label)
        if number is None:
            raise CommandError(10)
        return number

    def list_labels(self) -> list[str]:
        """Return the lines of `LL` (L7001)."""
        return [f"# {label} = {self.labels[label]}" for label in sorted(self.labels)]
