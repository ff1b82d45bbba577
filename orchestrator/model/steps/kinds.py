"""All kinds of steps that hold no other steps; `repeat` adds the one that does."""

from orchestrator.model.steps.dwell import Dwell
from orchestrator.model.steps.home import Home
from orchestrator.model.steps.io import SetOutput, WaitInput
from orchestrator.model.steps.latch import Latch
from orchestrator.model.steps.live import Live
from orchestrator.model.steps.motors import Disable, Enable
from orchestrator.model.steps.move import Move
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.probe import Probe
from orchestrator.model.steps.save_position import SavePosition
from orchestrator.model.steps.scan import Scan
from orchestrator.model.steps.set_position import SetPosition
from orchestrator.model.steps.wait_armed import WaitArmed

SingleStep = (
    Move
    | Home
    | Enable
    | Disable
    | SetPosition
    | SavePosition
    | Dwell
    | SetOutput
    | WaitInput
    | WaitArmed
    | Latch
    | Probe
    | Scan
    | FollowPath
    | Live
)

Motion = Move | FollowPath
"""A step that is one motion with an agreed start."""

MOTION_STEPS = ("move", "path")
"""The kinds of steps that are motion steps themselves; a scan consists of moves."""
