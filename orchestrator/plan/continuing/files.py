"""The file that a job was made of, as it is now."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from orchestrator.model.jobs.files import FileError, FileProblem
from orchestrator.model.paths.files.reading import digest_files
from orchestrator.plan.programs.settings import ProgramText

SUBMIT_ANEW = "the job is not continued; submit the file as a new job"


@dataclass(frozen=True, slots=True)
class JobFile:
    """A file of a job. folder: of the files that it needs; None: it came without them."""

    program: ProgramText
    folder: Path | None = None

    def require_same(self, name: str, digests: Mapping[str, str]) -> None:
        """Compare the file, which was called `name`, and what it needs with what ran. Raises `FileError` with every
        text that is another one."""
        other_names = [other_name for other_name in digests if other_name != name]
        if other_names and self.folder is None:
            text = f"its {', '.join(other_names)} cannot be compared here: `tutti job continue` does"
            raise FileError([FileProblem(name, 0, "", text)])
        present = {name: self.program.digest, **digest_files(other_names, self.folder or Path())}
        problems = [
            FileProblem(other_name, 0, "", f"the text is not that of {other_name!r} as it ran: {SUBMIT_ANEW}")
            for other_name, digest in digests.items()
            if present[other_name] != digest
        ]
        if problems:
            raise FileError(problems)
