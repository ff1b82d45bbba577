"""The largest requests, refused and accepted, beside the heartbeats of the coordinator: axes stop 0.5 s after the last
one."""

import json
import sys
import time
from itertools import pairwise

import pytest
from fleet import RunningFleet

from orchestrator.bus.base import BusSample, RequestRefused
from orchestrator.client import Tutti
from orchestrator.model.jobs.service import JobSubmitted

pytestmark = pytest.mark.live

PIECES = 20_000
LOST_S = 0.5
TIMEOUT_S = 60.0


def make_submission(pieces: int) -> bytes:
    """A legal job with a long path, on hold."""
    lines = [
        {"piece": "line", "to": [f"{1 + number // 2 * 0.001:.6f} mm", f"{1 + number % 2 * 0.01:.6f} mm"]}
        for number in range(pieces)
    ]
    path = {"do": "path", "axes": ["gantry.x", "gantry.y"], "speed": "10 mm/s", "tolerance": "10 um"}
    path |= {"start": ["0.5 mm", "1 mm"], "pieces": lines, "corner": {"within": "5 um"}}
    job = {"schema": "tutti.job/1", "name": "long", "steps": [path]}
    fields = {"request_id": "long", "actor": "test", "client_key": "long", "job": job, "terms": {"held": True}}
    return json.dumps(fields).encode()


def test_no_heartbeat_is_late_beside_the_largest_requests(shared: RunningFleet) -> None:
    refused_body = b"{%s}" % b",".join(b'"x%d":0' % number for number in range(790_000))

    async def main(tutti: Tutti) -> dict[str, float]:
        beats: list[float] = []
        longest: dict[str, float] = {}

        def take_beat(_: BusSample) -> None:
            beats.append(time.monotonic())

        def note_gap(name: str) -> None:
            longest[name] = max(late - early for early, late in pairwise(beats))
            beats.clear()

        await tutti.bus.subscribe(tutti.keys.leader, take_beat)
        key = tutti.keys.service("submit")
        for _ in range(2):  # the first one begins the process that reads it
            with pytest.raises(RequestRefused, match=r"request_id: Field required \(and 790003 mistakes more\)"):
                await tutti.bus.request(key, refused_body, TIMEOUT_S)
        note_gap("refused")
        answer = JobSubmitted.read_message(await tutti.bus.request(key, make_submission(PIECES), TIMEOUT_S))
        assert answer.refused is None, answer.refused
        note_gap("accepted")
        shown_job = await tutti.show_job(answer.job_id)
        assert shown_job.job is not None
        note_gap("shown")
        await tutti.cancel_job(answer.job_id)
        return longest

    longest = shared.ask(main, limit_s=100.0)  # three requests of 7 MB take 20 s on a free core
    sys.stdout.write(f"longest gap between heartbeats, s: {longest}\n")
    assert all(gap < LOST_S for gap in longest.values()), longest
