"""What every view says of a bus that other computers reach without TLS."""

from collections.abc import Iterable

from orchestrator.bus.endpoint import describe_openness
from orchestrator.model.operation.alarms import OPEN_BUS, AlarmRecord


def find_openness(endpoint: str, alarms: Iterable[AlarmRecord]) -> str:
    """By the endpoint that the view itself uses, and by the alarms of the fleet; "" where nothing is known of it. An
    alarm that was acknowledged or shelved counts as well: the bus is still open."""
    texts = (alarm.text for alarm in alarms if alarm.kind == OPEN_BUS and alarm.is_active)
    return (describe_openness(endpoint) if endpoint else "") or next(texts, "")
