"""The state of the queue in words."""

from orchestrator.model.report import QueueState


def describe_queue(state: QueueState) -> str:
    """Whether jobs begin and how many wait: one line."""
    jobs = "1 job waits" if state.waiting == 1 else f"{state.waiting} jobs wait"
    if state.stopped is None:
        return f"the queue is running; {jobs}"
    since = state.stopped.utc[:19].replace("T", " ")
    return f"the queue is stopped since {since} UTC ({state.stopped.reason}); {jobs}: tutti queue start"
