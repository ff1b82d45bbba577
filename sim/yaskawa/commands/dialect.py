"""The complete command table of the family: importing this module registers every command and operand."""

from sim.yaskawa.commands import contour as commands_contour
from sim.yaskawa.commands import data as commands_data
from sim.yaskawa.commands import encoder as commands_encoder
from sim.yaskawa.commands import ethernet as commands_ethernet
from sim.yaskawa.commands import flow as commands_flow
from sim.yaskawa.commands import gear as commands_gear
from sim.yaskawa.commands import motion as commands_motion
from sim.yaskawa.commands import operands
from sim.yaskawa.commands import parameters as commands_parameters
from sim.yaskawa.commands import sequence as commands_sequence
from sim.yaskawa.commands import status as commands_status
from sim.yaskawa.commands import system as commands_system
from sim.yaskawa.commands import trip as commands_trip
from sim.yaskawa.language.registry import COMMANDS, OPERANDS

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
