"""The description of a controller with text lines: a YAML file."""

from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Annotated, Any, Literal, Self, cast

from pydantic import AfterValidator, Field, PrivateAttr, model_validator

from adapters.ascii.patterns import LinePattern
from adapters.toolkit.lines.dialect import LineState
from orchestrator.model.base import Model
from orchestrator.model.errors import TuttiError
from orchestrator.model.jobs.files import FileError, LoadedFile, read_file, require_mapping, validate_value

PACKAGED = Path(__file__).with_name("descriptions")


class DescriptionError(TuttiError, ValueError):
    """A description that cannot be used; the message names file, field and reason."""


def _check_pattern(text: str) -> str:
    LinePattern(text)
    return text


Pattern = Annotated[str, Field(min_length=1), AfterValidator(_check_pattern)]
Text = Annotated[str, Field(max_length=500)]


class _Part(Model):
    """A part of a description."""


def _require_groups(pattern: str, *names: str) -> None:
    missing_groups = [f"(?P<{name}>…)" for name in names if name not in LinePattern(pattern).groups]
    if missing_groups:
        raise ValueError(f"the pattern {pattern!r} has no group {', '.join(missing_groups)}")


class StepText(_Part):
    """One step of a procedure."""

    send: Text = Field(default="", description="What is sent, with its end of line; {names} are filled in.")
    last: Pattern | None = Field(default=None, description="The last line of the reply; left out: no reply.")
    until: list[LineState] = Field(default=[], description="Then the status is read until it is one of these.")
    timeout_s: float | None = Field(default=None, gt=0, le=3600)


class QueryText(_Part):
    """A query and its reply."""

    send: Text
    last: Pattern = Field(description="The last line of the reply.")
    match: Pattern = Field(description="The line with the values.")


class IdentityText(QueryText):
    """Groups: model, firmware, serial, from all lines of the reply; only the model must be known. A line with the group
    `other` is that of a controller that needs another description: its name."""

    model: str = Field(default="", description="The model, if the reply does not name it.")

    @model_validator(mode="after")
    def _check_groups(self) -> "IdentityText":
        if not self.model:
            _require_groups(self.match, "model")
        return self


class StatusText(QueryText):
    """Groups: `positions`, separated by commas, in the order of `motors`; `state`, or `flags` with a number of bits for
    each motor; perhaps `free`, the free bytes of the receive buffer."""

    states: dict[str, LineState] = Field(
        default={},
        description="What each value of the group `state` means; `Run` also is `Run:2`, unless that is named.",
    )
    moving_bit: int = Field(default=0, ge=0, description="Value of the bit of `flags` that means: it moves.")
    forward_bit: int = Field(default=0, ge=0, description="Of the limit switch in forward direction.")
    reverse_bit: int = Field(default=0, ge=0)
    armed_bit: int = Field(default=0, ge=0, description="Of a loaded move.")
    free_when_empty: int = Field(default=0, ge=0, description="Free bytes of an empty receive buffer.")

    @model_validator(mode="after")
    def _check_groups(self) -> "StatusText":
        _require_groups(self.match, "positions", "state" if self.states else "flags")
        if not self.states and not self.moving_bit:
            raise ValueError("`states`, or `moving_bit`, must say how motion is recognised")
        if self.free_when_empty:
            _require_groups(self.match, "free")
        return self


class SessionText(QueryText):
    """A volatile number, 0 after power-up, that nothing else uses. Group: number."""

    write: Text
    written: Pattern

    @model_validator(mode="after")
    def _check_groups(self) -> "SessionText":
        _require_groups(self.match, "number")
        return self


class SettingText(QueryText):
    """A stored setting that must have a value. Group: value. `{index}` in `match` is the number of the motor, from 0;
    then it is compared for each axis, and so it is with `bit: motor`."""

    item: str
    match: str
    value: float | Literal["scale", "acceleration", "velocity_per_minute", "searches_backwards"] = Field(
        description="A number, or what the fleet file states; searches_backwards: 1 for a search towards lower counts."
    )
    bit: Annotated[int, Field(ge=0, le=62)] | Literal["motor"] | None = Field(
        default=None, description="Compare only this bit, as 0 or 1; `motor`: that of the motor's number, from 0."
    )
    is_minimum: bool = False
    remedy: str


class Description(_Part):
    """Commands, reply patterns, units, status and timing of a controller."""

    schema_: Literal["tutti.ascii/1"] = Field(alias="schema")
    extends: str | None = Field(
        default=None, description="A description that comes with Tutti: what this file leaves out is that of it."
    )
    name: str
    motors: list[str] = Field(min_length=1, max_length=32)
    positions: Literal["units", "counts"] = Field(description="What it speaks in: units of the axis, or counts.")
    decimals: int = Field(default=4, ge=0, le=9, description="Of positions that are sent.")
    report_decimals: int = Field(default=4, ge=0, le=9, description="Of positions that are reported.")
    velocity_factor: float = Field(default=1.0, gt=0, description="60 for speeds per minute.")
    reply_ends: list[str] = Field(default=["\n"], min_length=1)
    joint: bool = Field(default=False, description="Axes move along a straight line, with one speed on the path.")
    fixed_acceleration: bool = False
    armed_state: LineState = "idle"
    answers_while_homing: bool = True
    keeps_session: bool = Field(default=True, description="A stop does not clear the session number.")
    spoiler: Text = Field(description="Ends a half-typed line, and does nothing else.")
    stop: Text
    stop_search: Text | None = Field(default=None, description="Left out: like `stop`.")
    jog_stop: Text = Field(description="Stops one axis: {motor}.")
    restarted: Pattern | None = None
    ignored: Pattern | None = Field(default=None, description="Lines that belong to no command.")
    refused: Pattern = Field(description="A refusal; its group `reason` is shown.")
    identity: IdentityText
    status: StatusText
    session: SessionText
    settings: list[SettingText] = Field(default=[])
    target: Text = Field(description="One axis of a move: {motor}, {number}, {position}, {velocity}, {acceleration}.")
    separator: str = ""
    load: list[StepText] = Field(description="Load a move without starting it: {targets}, {path_velocity}.")
    start: StepText
    finish_stop: list[StepText]
    home: list[StepText] = Field(description="{motors}; a step with {motor} or {number} is sent for each motor.")
    jog: list[StepText]
    enable: list[StepText] = Field(default=[], description="Sent when axes are enabled.")
    clear_alarm: list[StepText] = Field(default=[])
    reference: float = Field(default=0.0, description="Position that the controller has at the reference.")

    _files: tuple[LoadedFile, ...] = PrivateAttr(default=())

    def locate_fields(self, files: tuple[LoadedFile, ...]) -> Self:
        """Note the files in which it is written: its own, then what that extends."""
        self._files = files
        return self

    def find_place(self, *field: str | int) -> str:
        """Where a field of it is written, for messages: file, line and field, e.g. `grbl.yaml:33: session`."""
        file = next((file for file in self._files if _is_written(file, field)), None)
        if file is None:
            return ".".join(map(str, field))
        problem = file.problem(field, "")
        return f"{Path(file.name).name}:{problem.line}: {problem.field}"

    @model_validator(mode="after")
    def _check_texts(self) -> "Description":
        allowed_names = {
            "target": {"motor", "number", "position", "velocity", "acceleration"},
            "load": {"targets", "path_velocity"},
            "home": {"motors", "motor", "number"},
            "jog": {"motor", "number", "position", "velocity", "acceleration"},
            "jog_stop": {"motor", "number"},
            "session.write": {"number"},
        }
        texts = {"target": [self.target], "jog_stop": [self.jog_stop], "session.write": [self.session.write]}
        texts |= {name: [step.send for step in getattr(self, name)] for name in ("load", "home", "jog")}
        for name, lines in texts.items():
            for text in lines:
                _check_names(name, text, allowed_names[name])
        return self


def _check_names(field: str, text: str, allowed: set[str]) -> None:
    try:
        text.format(**dict.fromkeys(allowed, "1"))
    except (KeyError, IndexError, ValueError) as error:
        names = ", ".join(f"{{{allowed_name}}}" for allowed_name in sorted(allowed))
        raise ValueError(f"{field}: {text!r} has an unknown name {error}; known are {names}") from None


def _is_written(file: LoadedFile, field: Sequence[str | int]) -> bool:
    """Return whether a file has a field itself."""
    value: Any = file.root.value
    for part in field:
        try:
            value = value[part]
        except (KeyError, IndexError, TypeError):
            return False
    return True


@cache
def load_description(name: str) -> Description:
    """Return the description of a packaged name or a path. Raises `DescriptionError`.

    A process reads it once, when it checks the fleet file: a stop must not depend on a file that was changed since.
    """
    packaged_file = PACKAGED / f"{name}.yaml"
    path = packaged_file if "/" not in name and packaged_file.is_file() else Path(name)
    if not path.is_file():
        known_names = ", ".join(packaged_names())
        raise DescriptionError(f"{name[:200]} is no file; give the path of a description, or one of {known_names}")
    try:
        return _parse_description(read_file(path))
    except FileError as error:
        raise DescriptionError(str(error)) from None


def _parse_description(file: LoadedFile) -> Description:
    """Make a description of what was read, and of what it extends. Raises `FileError`."""
    require_mapping(file, Description)
    files = [file]
    value: dict[str, Any] = file.root.value
    while (name := files[-1].root.value.get("extends")) is not None:
        if name not in packaged_names():
            known_names = ", ".join(packaged_names())
            raise FileError([files[-1].problem(("extends",), f"{name!r:.200} is none of {known_names}")])
        files.append(read_file(PACKAGED / f"{name}.yaml"))
        value = _merge(files[-1].root.value, value)
    description, problems = validate_value(value, Description)
    if description is None:
        raise FileError(file.problem(problem.place, problem.text) for problem in problems)
    return description.locate_fields(tuple(files))


def _merge(base: Mapping[str, Any], own: Mapping[str, Any]) -> dict[str, Any]:
    """Return the fields of both; those of a mapping one by one, anything else whole."""
    union = {**base, **own}
    for name, value in own.items():
        if isinstance(value, dict) and isinstance(base.get(name), dict):
            union[name] = _merge(base[name], cast("dict[str, Any]", value))
    return union


def packaged_names() -> list[str]:
    """Return the names of the descriptions that come with Tutti."""
    return sorted(path.stem for path in PACKAGED.glob("*.yaml"))
