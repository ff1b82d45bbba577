"""The state of the queue in words."""

from orchestrator.model.report import QueueState
from orchestrator.monitor.times import format_time


def describe_queue(state: QueueState) -> str:
    """Whether jobs begin and how many wait: one line."""
    jobs = "1 job waits" if state.waiting == 1 else f"{state.waiting} jobs wait"
    if state.stopped is None:
        return f"the queue is running; {jobs}"
    since = format_time(state.stopped.utc)
    return f"the queue is stopped since {since} ({state.stopped.reason}); {jobs}: tutti queue start"
