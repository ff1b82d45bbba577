"""The file that log lines are written to, live."""

from pathlib import Path

from orchestrator.bus.log import LogSink


def make_file_sink(path: Path) -> LogSink:
    """Make a sink that appends to `path`; each line is written at once, so that it survives a crash of this process."""
    path.parent.mkdir(parents=True, exist_ok=True)
    file = path.open("a", encoding="utf-8", buffering=1)

    def append_line(line: str) -> None:
        file.write(line + "\n")

    return append_line
