"""Fleets for tests of jobs and scripts.

from tutti.testing import virtual_fleet

with virtual_fleet("lab.fleet.yaml", seed=1) as fleet:
    fleet.tutti.home()
    fleet.fail("stage", "power-off", at="2 s")
    ...

`virtual_fleet` runs in virtual time, which jumps; `live_fleet` is one of processes, on this computer. Both are also
fixtures of the pytest plugin, by the same names.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from orchestrator.runtime.examples import find_example
    from orchestrator.testing.errors import BadTest, CallbackFailed, FleetViolation
    from orchestrator.testing.fault_schedule import InjectedFault
    from orchestrator.testing.live import LiveFault, LiveTestbed, live_fleet
    from orchestrator.testing.truth import AxisTruth, TrueMove
    from orchestrator.testing.virtual import VirtualTestbed, virtual_fleet
    from orchestrator.testing.virtual_worker import CallTooLong

__all__ = [
    "AxisTruth",
    "BadTest",
    "CallTooLong",
    "CallbackFailed",
    "FleetViolation",
    "InjectedFault",
    "LiveFault",
    "LiveTestbed",
    "TrueMove",
    "VirtualTestbed",
    "find_example",
    "live_fleet",
    "virtual_fleet",
]

# Imported when they are used: the plugin is loaded by every run of pytest, and most need no fleet.
_MODULES = {
    "AxisTruth": "orchestrator.testing.truth",
    "BadTest": "orchestrator.testing.errors",
    "CallTooLong": "orchestrator.testing.virtual_worker",
    "CallbackFailed": "orchestrator.testing.errors",
    "FleetViolation": "orchestrator.testing.errors",
    "InjectedFault": "orchestrator.testing.fault_schedule",
    "LiveFault": "orchestrator.testing.live",
    "LiveTestbed": "orchestrator.testing.live",
    "TrueMove": "orchestrator.testing.truth",
    "VirtualTestbed": "orchestrator.testing.virtual",
    "find_example": "orchestrator.runtime.examples",
    "live_fleet": "orchestrator.testing.live",
    "virtual_fleet": "orchestrator.testing.virtual",
}


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_MODULES[name]), name)
