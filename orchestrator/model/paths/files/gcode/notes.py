"""What a program has that changes no path, in words."""

from collections import Counter
from dataclasses import dataclass, field

from orchestrator.model.paths.files.gcode.errors import LineError
from orchestrator.model.paths.files.gcode.words import Word
from orchestrator.model.paths.gcode_settings import GcodeSettings


@dataclass(slots=True)
class SkipNotes:
    """What was skipped: by itself, and by an entry of `gcode:`; and what such an entry makes of codes. kept: what
    stays behind the program, in words."""

    skipped: Counter[str] = field(default_factory=Counter[str])
    mapped: Counter[str] = field(default_factory=Counter[str])
    acted: Counter[str] = field(default_factory=Counter[str])
    kept: dict[str, None] = field(default_factory=dict[str, None])

    def skip(self, name: str) -> None:
        """Note what changes no path and no tool."""
        self.skipped[name] += 1

    def skip_by_entry(self, name: str) -> None:
        """Note what an entry of `gcode:` lets skip."""
        self.mapped[name] += 1

    def act_by_entry(self, name: str) -> None:
        """Note what an entry of `gcode:` switches, or waits for."""
        self.acted[name] += 1

    def keep(self, text: str) -> None:
        """Note what stays behind the program."""
        self.kept[text] = None

    def require_entry(self, settings: GcodeSettings, entry: str, name: str, word: Word) -> None:
        """Note what an entry of `gcode:` lets skip. Raises `LineError` without the entry."""
        if getattr(settings, entry) is None:
            reason = "has none, or a person sees to it" if entry != "tools" else "has one tool, or a person sees to it"
            raise LineError(word.column, f"{name} needs `gcode: {{{entry}: none}}`, if the machine {reason}")
        self.skip_by_entry(name)

    def describe(self) -> list[str]:
        """At most three lines, and those of what stays."""
        texts = (
            ("skipped, changes no path and no tool", self.skipped),
            ("skipped by `gcode:`", self.mapped),
            ("switched, or waited for, by `gcode:`", self.acted),
        )
        lines = [
            f"{text}: " + ", ".join(f"{name} ({count})" if count > 1 else name for name, count in counts.items())
            for text, counts in texts
            if counts
        ]
        return [*lines, *self.kept]
