"""Which log lines are wanted."""

from dataclasses import dataclass

from orchestrator.monitor.logs.line import LogLevel
from orchestrator.monitor.logs.placing import PlacedLine


@dataclass(frozen=True, slots=True)
class LogFilter:
    """Keeps the lines that pass all of its conditions; None: any line.

    job: the beginning of its id. level: this one and above. since_ns: instant since 1970.
    """

    job: str | None = None
    controller: str | None = None
    level: LogLevel = "info"
    since_ns: int | None = None

    def accepts(self, placed: PlacedLine) -> bool:
        """Whether the line is wanted."""
        line = placed.line
        return (
            (self.job is None or (line.job or "").startswith(self.job))
            and (self.controller is None or line.controller == self.controller)
            and (self.level == "info" or line.level == "warning")
            and (self.since_ns is None or placed.at_ns >= self.since_ns)
        )
