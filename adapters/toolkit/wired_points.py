"""The trigger input that a step waits for, and the trigger output that it drives, by their names in the fleet file."""

from collections.abc import Mapping

from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Controller, DigitalInput, DigitalOutput
from orchestrator.model.messages import TriggerDrive, TriggerWait


def find_wait_input(config: Controller, wait: TriggerWait) -> DigitalInput:
    """Return the input to wait for. Raises `Refusal` for an input that the fleet file does not name."""
    point = config.inputs.get(wait.input)
    if point is None:
        raise Refusal(
            "start-class",
            f"no start by trigger line: the controller has no input {wait.input}; inputs: {_list_names(config.inputs)}",
            "name the input in the fleet file",
        )
    return point


def find_driven_output(config: Controller, drive: TriggerDrive) -> DigitalOutput:
    """Return the output to drive. Raises `Refusal` for an output that the fleet file does not name."""
    point = config.outputs.get(drive.output)
    if point is None:
        raise Refusal(
            "start-class",
            f"no trigger line to drive: the controller has no output {drive.output}; "
            f"outputs: {_list_names(config.outputs)}",
            "name the output in the fleet file",
        )
    return point


def _list_names(points: Mapping[str, object]) -> str:
    return ", ".join(points) or "none"
