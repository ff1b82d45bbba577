"""The contract for simulators of makes, and parts for them: an axis that moves in trapezoids, a controller with text
lines. A simulator never imports its adapter: both are independent readings of the manual."""

from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US, Clock
from orchestrator.link.supply import PowerSupply
from orchestrator.model.fleet import Axis, Controller
from orchestrator.model.plugins import SIMULATOR_API_VERSION as API_VERSION
from sim.core.commissioning import search_distance, span_counts
from sim.core.controller import (
    CommandedMotion,
    DeviceSpec,
    FirmwareTiming,
    LimitSwitch,
    LineEndpoint,
    PortConnection,
    PortRefused,
    SendBytes,
    SharingSimulator,
    SimulatedController,
    Simulator,
    VectorBench,
    refuse_analog,
)
from sim.core.devicetime import DeviceTime
from sim.core.lines import LineController, LineDevice, LineFirmware, LinePort
from sim.core.oscillator import Oscillator
from sim.core.trapezoids import TrapezoidAxis

__all__ = [
    "API_VERSION",
    "NS_PER_MS",
    "NS_PER_S",
    "NS_PER_US",
    "Axis",
    "Clock",
    "CommandedMotion",
    "Controller",
    "DeviceSpec",
    "DeviceTime",
    "FirmwareTiming",
    "LimitSwitch",
    "LineController",
    "LineDevice",
    "LineEndpoint",
    "LineFirmware",
    "LinePort",
    "Oscillator",
    "PortConnection",
    "PortRefused",
    "PowerSupply",
    "SendBytes",
    "SharingSimulator",
    "SimulatedController",
    "Simulator",
    "TrapezoidAxis",
    "VectorBench",
    "refuse_analog",
    "search_distance",
    "span_counts",
]
