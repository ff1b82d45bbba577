"""The complete command table of the family: importing this module enters every command and operand."""

from sim.yaskawa import (
    commands_contour,
    commands_data,
    commands_encoder,
    commands_ethernet,
    commands_flow,
    commands_gear,
    commands_motion,
    commands_parameters,
    commands_sequence,
    commands_status,
    commands_system,
    commands_trip,
    operands,
)
from sim.yaskawa.registry import COMMANDS, OPERANDS

MODULES = (
    commands_contour,
    commands_data,
    commands_encoder,
    commands_ethernet,
    commands_flow,
    commands_gear,
    commands_motion,
    commands_parameters,
    commands_sequence,
    commands_status,
    commands_system,
    commands_trip,
    operands,
)

__all__ = ["COMMANDS", "MODULES", "OPERANDS"]
