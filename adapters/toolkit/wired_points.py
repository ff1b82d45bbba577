"""The input that a step waits for, and the output that it drives, by their names in the fleet file."""

from collections.abc import Mapping

from adapters.contract import CannotDo
from orchestrator.model.fleet import Controller, Input, Output
from orchestrator.model.messages import LineDrive, LineWait


def waited_for(config: Controller, wait: LineWait) -> Input:
    """Raises `CannotDo` for an input that the fleet file does not name."""
    point = config.inputs.get(wait.input)
    if point is None:
        raise CannotDo(
            "start-class",
            f"no start by line: the controller has no input {wait.input}; there are {_named(config.inputs)}",
            "name the input in the fleet file",
        )
    return point


def driven(config: Controller, drive: LineDrive) -> Output:
    """Raises `CannotDo` for an output that the fleet file does not name."""
    point = config.outputs.get(drive.output)
    if point is None:
        raise CannotDo(
            "start-class",
            f"no line to drive: the controller has no output {drive.output}; there are {_named(config.outputs)}",
            "name the output in the fleet file",
        )
    return point


def _named(points: Mapping[str, object]) -> str:
    return ", ".join(points) or "none"
