"""A program in G-code and what is chosen for it as a job, with the line of each piece."""

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, FileProblem
from orchestrator.model.jobs.job import Job
from orchestrator.model.paths.files.base.imported import ImportedSteps, make_job
from orchestrator.model.paths.files.gcode.reader import GcodeReader
from orchestrator.plan.path.resolve import ResolvedPath
from orchestrator.plan.programs.imported_job import check_pieces, complete_steps, make_imported_job
from orchestrator.plan.programs.settings import DIGEST, FROM_LINE, PROGRAM, ProgramSettings, ProgramText

_CONFIRMED: Mapping[str, str] = {
    "spindle": "spindle: none. M3, M4, M5 and S switch nothing: it turns already, or there is none",
    "tools": "tools: none. T, M6 and G43 change nothing: the right tool is in",
    "coolant": "coolant: none. M7 and M8 switch nothing",
    "pause": "pause: none. The program does not wait at M0 and M1",
}


@dataclass(frozen=True, slots=True)
class ProgramJob:
    """job: of the whole rest of the program; from a line on, it begins with a move. paths: its paths in numbers."""

    program: ProgramText
    settings: ProgramSettings
    job: Job
    imported: ImportedSteps
    paths: list[ResolvedPath]

    @property
    def approach(self) -> Mapping[str, str]:
        """Where the axes go to before its first line, by a move that is its first step; empty: it begins at its
        beginning."""
        return self.imported.steps[0]["to"] if self.settings.from_line > 1 else {}

    def split_approach(self) -> tuple[Job, Job]:
        """The move to where the program stands, and the rest, as jobs of their own."""
        move = self.job.model_copy(
            update={
                "name": f"{self.job.name}: to line {self.settings.from_line}",
                "steps": self.job.steps[:1],
                "parameters_used": {},
            }
        )
        return move, self.job.model_copy(update={"steps": self.job.steps[1:]})

    def list_confirmations(self) -> list[str]:
        """What a person has to see to before it runs, in words: what the machine does not do itself, and the modes
        that the lines before leave."""
        gcode = self.settings.gcode
        texts = [text for name, text in _CONFIRMED.items() if getattr(gcode, name) == "none"]
        if self.settings.from_line > 1:
            texts.append(f"line {self.settings.from_line} begins with {', '.join(self.imported.modes)}")
        return texts


def make_program_job(program: ProgramText, settings: ProgramSettings, fleet: Fleet) -> ProgramJob:
    """The job of a program. Raises `FileError` with every mistake, by line and column."""
    reader = GcodeReader(program.name, settings.axes, settings.start, settings.gcode)
    contents = reader.read_all(program.lines, settings.from_line)
    contents = replace(contents, digests={Path(program.name).name: program.digest})
    fields: dict[str, Any] = {"tolerance": settings.tolerance}
    if settings.corner != "stop":
        fields["corner"] = {"within": settings.corner}
    steps = complete_steps(contents, fields)
    plain = make_job(program.name[:100], steps) | {
        "parameters_used": {PROGRAM: program.name[:100], DIGEST: program.digest, **settings.texts}
    }
    job = make_imported_job(contents, plain)
    return ProgramJob(program, settings, job, contents, check_pieces(job, fleet))


def require_unchanged(program: ProgramText, settings: ProgramSettings, used: Mapping[str, str]) -> None:
    """Compare with the parameters of the job that is to be continued. Raises `FileError` with what has changed."""
    present_texts = {DIGEST: program.digest, **settings.texts}
    problems: list[FileProblem] = []
    for name in sorted(present_texts.keys() | (used.keys() - {PROGRAM})):
        present_text, former_text = present_texts.get(name, "absent"), used.get(name, "absent")
        if present_text == former_text or name == FROM_LINE:
            continue
        text = f"{name!r} is {present_text!r} and was {former_text!r}"
        if name == DIGEST:
            text = f"the text is not that of {used.get(PROGRAM, 'the program')!r} as it ran"
        remedy = "the program is not continued; choose the file as a new job, and a line to start at"
        problems.append(FileProblem(program.name, 0, "", f"{text}: {remedy}"))
    if problems:
        raise FileError(problems)
