"""Files of sequences are read, and files of jobs written."""

from pathlib import Path
from typing import Any

import yaml
from pydantic import ValidationError
from useq import MDASequence

from integrations.useq.steps import UnmappedSequence

MAX_NAME = 60


def read_sequence(file: Path) -> MDASequence:
    """Read a sequence. Raises `UnmappedSequence` with each wrong value and its place."""
    try:
        return MDASequence.from_file(str(file))
    except ValidationError as error:
        problems = [f"{'.'.join(map(str, detail['loc']))}: {detail['msg']}" for detail in error.errors()]
        raise UnmappedSequence(problems) from None
    except (OSError, UnicodeDecodeError, ValueError, TypeError, yaml.YAMLError) as error:
        text = " ".join(str(error).split())[:300]
        raise UnmappedSequence([f"it is no sequence of useq-schema: {text}"]) from None


def write_job(target: Path, source: Path, steps: list[dict[str, Any]]) -> None:
    """Write a job file."""
    document = {"schema": "tutti.job/1", "name": source.stem[:MAX_NAME] or "sequence", "steps": steps}
    text = yaml.safe_dump(document, sort_keys=False, default_flow_style=None, width=120, allow_unicode=True)
    target.write_text(f"# From {source.name}, a sequence of useq-schema.\n{text}", encoding="utf-8")
