"""Where log lines go, live."""

from pathlib import Path

from orchestrator.bus.log import Sink


def file_sink(path: Path) -> Sink:
    """A sink that appends to `path`, each line written at once so that it survives a crash of this process."""
    path.parent.mkdir(parents=True, exist_ok=True)
    file = path.open("a", encoding="utf-8", buffering=1)

    def write(line: str) -> None:
        file.write(line + "\n")

    return write
