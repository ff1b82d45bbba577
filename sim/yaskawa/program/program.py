"""Program memory: lines, labels, download (L4128-L4180, L12254-L12258)."""

from dataclasses import dataclass, field

from sim.yaskawa.base.data import Room
from sim.yaskawa.base.errors import CommandError

LINE_LENGTH = 80
LABEL_LENGTH = 7


def label_of(line: str) -> str | None:
    """The label that a line defines, without `#`, or None."""
    text = line.lstrip()
    if not text.startswith("#"):
        return None
    return text[1:].partition(";")[0].replace(" ", "")


@dataclass(slots=True)
class Program:
    """The program in memory; lines are numbered from 0."""

    room: Room
    lines: list[str] = field(default_factory=list[str])
    labels: dict[str, int] = field(default_factory=dict[str, int])

    def clear(self) -> None:
        self.lines.clear()
        self.labels.clear()

    def insert(self, at: int, lines: list[str]) -> None:
        """Put lines in before line `at`; as `replace`."""
        self.replace(self.lines[:at] + lines + self.lines[at:])

    def replace(self, lines: list[str]) -> None:
        """Another program; refused (60, 61, 62, and 10: L14436), the memory stays as it was."""
        if any(not line.strip() or "\t" in line for line in lines):
            raise CommandError(10)
        if len(lines) > self.room.lines or any(len(line) > LINE_LENGTH for line in lines):
            raise CommandError(60)
        labels: dict[str, int] = {}
        for number, line in enumerate(lines):
            label = label_of(line)
            if label is None:
                continue
            if not 1 <= len(label) <= LABEL_LENGTH or not label[0].isalpha() or label in labels:
                raise CommandError(61)
            labels[label] = number
        if len(labels) > self.room.labels:
            raise CommandError(62)
        self.lines, self.labels = lines, labels

    def line_of(self, label: str) -> int:
        """The line that defines `label`."""
        number = self.labels.get(label)
        if number is None:
            raise CommandError(10)
        return number

    def list_labels(self) -> list[str]:
        """The lines of `LL` (L7001)."""
        return [f"# {label} = {self.labels[label]}" for label in sorted(self.labels)]
