"""Templates: job files with parameters, and the jobs that are made of them.

Values are put in after the file is read and before the job is validated, so that every mistake keeps its line. A job
that is submitted has plain steps; the coordinator knows no templates.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, cast

from orchestrator.model.explain import show_value
from orchestrator.model.files.yaml_reader import YamlNode, resolve_plain
from orchestrator.model.fleet_names import list_names, suggest_name
from orchestrator.model.jobs.files import (
    FileError,
    FileProblem,
    LoadedFile,
    locate_point_files,
    read_file,
    require_mapping,
    validate_part,
    validate_value,
)
from orchestrator.model.jobs.job import Job
from orchestrator.model.paths.files.steps import read_path_steps
from orchestrator.model.templates.button import ButtonDeclaration, JobButton
from orchestrator.model.templates.parameters import (
    MAX_PARAMETERS,
    Parameter,
    ParameterDeclarations,
    ParameterValue,
)
from orchestrator.model.templates.references import MARK, find_references, find_whole, replace_references

DECLARATIONS, USED, BUTTON = "parameters", "parameters_used", "button"
NOT_OF_JOB = (DECLARATIONS, BUTTON)  # parts of the file alone


@dataclass(frozen=True, slots=True)
class ParameterSetting:
    """A value for a parameter. source, line: where it is given, for messages; line 0: not in a file. written: it is
    the text of a command line, which the parameter's type makes a value of."""

    value: object
    source: str
    line: int = 0
    written: bool = False

    def read_by(self, parameter: Parameter) -> ParameterValue:
        """The value as the parameter reads it. Raises `ValueError`."""
        if self.written and parameter.type != "text":
            return parameter.read_value(resolve_plain(cast(str, self.value)))
        return parameter.read_value(self.value)


@dataclass(frozen=True, slots=True)
class FilledJob:
    """A job that was made of a file, and the places of its values there."""

    file: LoadedFile
    job: Job
    origins: Mapping[int, str] = field(default_factory=dict[int, str])

    def problem(self, place: Sequence[str | int], text: str) -> FileProblem:
        """A mistake at a place of the file; the parameters that the value there is made of are stated."""
        return _describe_problem(self.file, self.origins, place, text)


class Template:
    """A job file with parameters.

    `Template.load("scan.job.yaml").fill(width="20 mm", passes=5)` is a `Job`. parameters: the declarations, by name.
    button: how the operators' page offers the job; None: by its list of templates alone.
    """

    def __init__(self, file: LoadedFile) -> None:
        """Raises `FileError` if the file is no mapping. Other mistakes are reported when it is filled."""
        require_mapping(file, Job)
        self._file = file
        self._entries = cast("dict[str, YamlNode]", file.root.children)
        self._problems: list[FileProblem] = []
        self.parameters: dict[str, Parameter] = {}
        self.button: JobButton | None = None
        self._read_declarations()
        self._read_button()

    @classmethod
    def load(cls, path: Path | str) -> "Template":
        """Load the job file at `path`. Raises `FileError` with every mistake that it has, whatever the values."""
        template = cls(read_file(Path(path)))
        template.check()
        return template

    def check(self) -> None:
        """Raises `FileError` with every mistake that the file has, whatever the values."""
        problems, _ = self._fill_values(self._choose_placeholders())
        if problems:
            raise FileError(problems)

    def fill(self, values: Mapping[str, object] | None = None, /, **more: object) -> Job:
        """The job with these values, as a file would give them; a parameter without a value has its default.

        values: by name; also as keywords. Raises `FileError` with every mistake: unknown and missing names, values of
        a wrong type or unit or beyond a bound, and fields of the job that are wrong with these values.
        """
        all_values = {**(values or {}), **more}
        return self.fill_settings(
            {name: ParameterSetting(value, "parameters") for name, value in all_values.items()}
        ).job

    def fill_settings(self, settings: Mapping[str, ParameterSetting]) -> FilledJob:
        """The job with these settings, by name. Raises `FileError` with every mistake."""
        values, problems = self._read_settings(settings)
        more, filled_job = self._fill_values(values)
        if filled_job is None or problems:
            raise FileError([*problems, *more])
        return filled_job

    def list_extremes(
        self, settings: Mapping[str, ParameterSetting]
    ) -> Iterator[tuple[str, dict[str, ParameterSetting]]]:
        """Further values that its bounds and choices allow: one parameter at a time, in words, with the settings."""
        for name, parameter in self.parameters.items():
            for extreme, value in parameter.list_extremes():
                words = f"{name}={parameter.read_value(value).text}" + (f" ({extreme})" if extreme else "")
                yield words, {**settings, name: ParameterSetting(value, "parameters")}

    def list_unused(self) -> list[FileProblem]:
        """Parameters that are declared and that no value refers to."""
        used_names = {reference.name for node in self._list_values() for reference in find_references(str(node.value))}
        return [
            self._file.problem((DECLARATIONS, name), f"is declared and not used; write ${{{name}}}, or remove it")
            for name in self.parameters
            if name not in used_names
        ]

    # Declarations and settings

    def _read_declarations(self) -> None:
        node = self._entries.get(DECLARATIONS)
        if node is None:
            return
        if USED in self._entries:
            text = "is written when a template is filled; remove it, or remove `parameters`"
            self._problems.append(self._file.problem((USED,), text))
        declarations = node.value if isinstance(node.children, dict) else {"": node.value}
        if not isinstance(node.children, dict) or len(declarations) > MAX_PARAMETERS:
            self._add_declaration_problems(node.value)
            return
        # One by one, so that a mistake in one does not hide the others.
        for name, value in declarations.items():
            problems = self._add_declaration_problems({name: value})
            self.parameters |= {} if problems is None else problems.parameters

    def _read_button(self) -> None:
        node = self._entries.get(BUTTON)
        if node is None:
            return
        declaration, problems = validate_part({BUTTON: node.value}, ButtonDeclaration)
        self._problems += [self._file.problem(problem.place, problem.text) for problem in problems]
        self.button = None if declaration is None else declaration.button

    def _add_declaration_problems(self, value: Any) -> ParameterDeclarations | None:
        declarations, problems = validate_part({DECLARATIONS: value}, ParameterDeclarations)
        self._problems += [self._file.problem(problem.place, problem.text) for problem in problems]
        return declarations

    def _read_settings(
        self, settings: Mapping[str, ParameterSetting]
    ) -> tuple[dict[str, ParameterValue], list[FileProblem]]:
        values: dict[str, ParameterValue] = {}
        problems: list[FileProblem] = []
        for name, setting in settings.items():
            if name not in self._declared:
                problems.append(FileProblem(setting.source, setting.line, name, self._explain_unknown(name)))
        for name, parameter in self.parameters.items():
            setting = settings.get(name)
            if setting is not None:
                try:
                    values[name] = setting.read_by(parameter)
                except ValueError as error:
                    problems.append(FileProblem(setting.source, setting.line, name, str(error)))
            elif parameter.default is not None:
                values[name] = parameter.read_value(parameter.default)
            else:
                text = f"has no default; give it a value: `--set {name}=…`"
                problems.append(self._file.problem((DECLARATIONS, name), text))
        return values, problems

    def _choose_placeholders(self) -> dict[str, ParameterValue]:
        """The defaults, or else a value that is allowed, where one is stated."""
        values: dict[str, ParameterValue] = {}
        for name, parameter in self.parameters.items():
            extremes = [value for _, value in parameter.list_extremes()]
            default = parameter.default if parameter.default is not None else next(iter(extremes), None)
            if default is not None:
                values[name] = parameter.read_value(default)
        return values

    @property
    def _declared(self) -> list[str]:
        """The names that the file declares, also wrongly."""
        node = self._entries.get(DECLARATIONS)
        return list(node.children) if node is not None and isinstance(node.children, dict) else []

    def _explain_unknown(self, name: str) -> str:
        known_names = self._declared
        name_list = list_names(known_names, "parameter") if known_names else "it declares none (`parameters:`)"
        return f"the job file has no parameter {name[:80]}; {suggest_name(name, known_names)}{name_list}"

    # Values

    def _fill_values(self, values: Mapping[str, ParameterValue]) -> tuple[list[FileProblem], FilledJob | None]:
        """All mistakes of the file with these values; and the job, if there are none and every value is there."""
        filler = _ValueFiller(self.parameters, values)
        plain = {key: filler.fill_node(node, (key,)) for key, node in self._entries.items() if key not in NOT_OF_JOB}
        if self.parameters:
            plain[USED] = {name: value.text for name, value in values.items()}
        problems = list(self._problems)
        for path, unknown, text in filler.problems:
            if unknown is None or unknown not in self._declared:
                problems.append(self._file.problem(path, text or self._explain_unknown(unknown or "")))
        job, found_problems = validate_value(plain, Job)
        for problem in found_problems:
            # What stands for a value that is wrong itself says nothing.
            if id(self._file.find_node(problem.place)) not in filler.failed:
                problems.append(_describe_problem(self._file, filler.origins, problem.place, problem.text))
        if job is None or problems or filler.failed:
            return problems, None
        # Relative names of files are of those beside the job file.
        folder = Path(self._file.name).parent
        try:
            new_job = read_path_steps(locate_point_files(job, folder), folder)
        except FileError as error:
            return list(error.problems), None
        return [], FilledJob(self._file, new_job, filler.origins)

    def _list_values(self) -> Iterator[YamlNode]:
        """All scalars that are no declarations."""
        todo = [node for key, node in self._entries.items() if key not in NOT_OF_JOB]
        while todo:
            node = todo.pop()
            if node.children is None:
                yield node
            todo += [child for _, child in node.entries()]


class _ValueFiller:
    """Puts values in place of references.

    origins: by the id of a node, the parameters of its value in words. failed: ids of nodes without a value. problems:
    each with its place, and the name of the parameter if that is not declared, else a text.
    """

    def __init__(self, parameters: Mapping[str, Parameter], values: Mapping[str, ParameterValue]) -> None:
        self._parameters = parameters
        self._values = values
        self.origins: dict[int, str] = {}
        self.failed: set[int] = set()
        self.problems: list[tuple[tuple[str | int, ...], str | None, str]] = []

    def fill_node(self, node: YamlNode, place: tuple[str | int, ...]) -> Any:
        """The plain value of a node with all values in it. place: keys and indices that lead to it."""
        if isinstance(node.children, dict):
            for key in node.children:
                if MARK in key:
                    text = "a parameter stands for a value, not for a key; write the key out"
                    self.problems.append(((*place, key), None, text))
            return {key: self.fill_node(child, (*place, key)) for key, child in node.children.items()}
        if node.children is not None:
            return [self.fill_node(child, (*place, number)) for number, child in enumerate(node.children)]
        return self._fill_text(node, place) if isinstance(node.value, str) and MARK in node.value else node.value

    def _fill_text(self, node: YamlNode, place: tuple[str | int, ...]) -> Any:
        text = cast(str, node.value)
        references = list(find_references(text))
        wrong = [reference for reference in references if not reference.is_well_formed]
        for reference in wrong:
            words = f"{reference} is no reference; write ${{name}} with a-z, 0-9 and _, or $${{ for the text ${{ itself"
            self.problems.append((place, None, words))
        names = list(dict.fromkeys(reference.name for reference in references if reference.is_well_formed))
        self.problems += [(place, name, "") for name in names if name not in self._parameters]
        if wrong or any(name not in self._values for name in names):
            self.failed.add(id(node))
            return text
        if names:
            self.origins[id(node)] = ", ".join(f"${{{name}}} is {self._values[name].text}" for name in names)
        whole_reference = find_whole(text)
        if whole_reference is None:
            return replace_references(text, lambda name: self._values[name].text)
        name, negative = whole_reference
        try:
            value = self._values[name]
            return (self._parameters[name].negate_value(value) if negative else value).plain
        except ValueError as error:
            self.problems.append((place, None, f"found {show_value(text)}; {error}"))
            self.failed.add(id(node))
            return text


def _describe_problem(
    file: LoadedFile, origins: Mapping[int, str], place: Sequence[str | int], text: str
) -> FileProblem:
    origin = origins.get(id(file.find_node(place)))
    return file.problem(place, text if origin is None else f"{text} ({origin})")


def read_settings_file(path: Path) -> dict[str, ParameterSetting]:
    """The settings in a YAML file, `name: value`. Raises `FileError`."""
    file = read_file(path)
    if not isinstance(file.root.children, dict):
        raise FileError([FileProblem(file.name, 1, "", "must be a mapping of names to values, e.g. `width: 20 mm`")])
    return {name: ParameterSetting(node.value, file.name, node.line) for name, node in file.root.children.items()}


def load_job(path: Path | str, parameters: Mapping[str, object] | None = None) -> Job:
    """Load the job file at `path`. parameters: values for those that it declares; without, their defaults.

    Raises `FileError` with every mistake.
    """
    return Template(read_file(Path(path))).fill(parameters)
