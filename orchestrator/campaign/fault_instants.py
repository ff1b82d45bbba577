"""When the fault of a phase comes: at an instant of a window that the requests of its stage determine."""

from collections.abc import Callable, Mapping
from random import Random

from orchestrator.campaign.recording.recorder import BusRecorder, RecordedRequest, Stage
from orchestrator.campaign.stages.fleet_parts import find_traits
from orchestrator.campaign.stages.flown_scans import find_flight_ns
from orchestrator.clock.base import NS_PER_MS, NS_PER_S, NS_PER_US
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.job import Job

# Time from the stage's first request to the member to the fault: earliest and latest.
_FAULT_WINDOWS_NS: dict[str, tuple[int, int]] = {
    "propose": (0, 500 * NS_PER_US),
    "commit": (0, NS_PER_MS),
    "go": (0, 500 * NS_PER_US),
}
FIRE_WINDOW_NS = 60 * NS_PER_MS  # around T0
_MOTION_WINDOW_NS = (150 * NS_PER_MS, 1500 * NS_PER_MS)  # after T0
_ZONE_WINDOW_NS = (100 * NS_PER_MS, 9 * NS_PER_S)  # after T0: a carriage goes out, others wait, and it goes back
_CHAIN_WINDOW_NS = 200 * NS_PER_MS  # after T0 of the step that was loaded behind another one
_ARMED_WINDOW_NS = 3 * NS_PER_S  # after arming; some steps are started before
_STAGES_AT_ONCE: tuple[Stage, ...] = ("arm", "commit", "go")  # which one request goes through
_REQUEST_WINDOWS_NS: dict[Stage, tuple[str, int]] = {
    "chunk": ("load-chunk", 3 * NS_PER_S),  # until after its release
    "at-once": ("start-at-once", 500 * NS_PER_MS),  # behind a moving step, until after its start
}
"""The request of a stage, and the window of the fault from when it is sent."""
# a controller that verifies its position, and does not move
_VERIFIED_HOMING_NS = 250 * NS_PER_MS
PROBE_SHARE = 0.6  # of the time of a probe that touches nothing: most are touched later
HOMING_SHARE = 0.4  # of the expected homing time: within it nearly all axes are still homing

_Window = tuple[int, int]
"""The earliest and the latest instant of a fault, host ns."""


class FaultInstants:
    """Draws the instants of faults in one fleet. find_positions: of each axis, in its unit. find_t0_ns: T0 of a
    request, host ns."""

    def __init__(
        self,
        fleet: Fleet,
        recorder: BusRecorder,
        draw: Random,
        find_positions: Callable[[], Mapping[str, float]],
        find_t0_ns: Callable[[RecordedRequest], int],
    ) -> None:
        self._fleet = fleet
        self._recorder = recorder
        self._draw = draw
        self._find_positions = find_positions
        self._find_t0_ns = find_t0_ns

    def find_instant(self, stage: Stage, request: RecordedRequest, job: Job, now_ns: int) -> int | None:
        """The instant of the fault, host ns, once a request for a job determines it, which is sent or answered now;
        None for any other request."""
        if stage == "flying":
            is_begun = request.verb == "go" and request.accepted and self._is_path(request)
            return self._find_t0_ns(request) + self._draw.randrange(find_flight_ns(job)) if is_begun else None
        find_window = self._find_sent_window if request.answered_ns is None else self._find_answered_window
        window = find_window(stage, request, now_ns)
        return None if window is None else self._draw.randint(*window)

    def _find_sent_window(self, stage: Stage, request: RecordedRequest, now_ns: int) -> _Window | None:
        if _is_of_stage(request, stage):
            if stage == "home":
                return now_ns, now_ns + self._expected_homing_ns(request.member)
            if stage == "probe":
                return now_ns, now_ns + round(PROBE_SHARE * self._expected_probe_ns(request))
            if stage == "arm":
                return now_ns, now_ns + self._expected_arming_ns(request.member)
            if stage in _FAULT_WINDOWS_NS:
                earliest_ns, latest_ns = _FAULT_WINDOWS_NS[stage]
                return now_ns + earliest_ns, now_ns + latest_ns
        verb, window_ns = _REQUEST_WINDOWS_NS.get(stage, ("", 0))
        if request.verb == verb and request.fields.get("after_step", 0) is not None:
            return now_ns, now_ns + window_ns - 1
        return None

    def _find_answered_window(self, stage: Stage, request: RecordedRequest, now_ns: int) -> _Window | None:
        if not request.accepted:
            return None
        if request.verb == "arm":
            return self._find_armed_window(stage, request, now_ns)
        if request.verb not in ("go", "start-at-once"):
            return None
        t0_ns = self._find_t0_ns(request)
        if stage == "fire":
            return min(now_ns, t0_ns), t0_ns + FIRE_WINDOW_NS
        if stage in ("motion", "trigger", "virtual", "pair"):
            return t0_ns + _MOTION_WINDOW_NS[0], t0_ns + _MOTION_WINDOW_NS[1]
        if stage == "zone":
            return t0_ns + _ZONE_WINDOW_NS[0], t0_ns + _ZONE_WINDOW_NS[1]
        return None

    def _find_armed_window(self, stage: Stage, request: RecordedRequest, now_ns: int) -> _Window | None:
        """Of a step that a member has loaded while it waits, armed or behind a moving one."""
        if stage == "armed-waiting":
            return now_ns, now_ns + _ARMED_WINDOW_NS
        if stage in ("chain", "live") and request.fields["after_step"] is not None:
            return now_ns, max(now_ns, self._find_t0_ns(request) + _CHAIN_WINDOW_NS)
        return None

    def _is_path(self, go: RecordedRequest) -> bool:
        """Whether a member was started on a path: that to the beginning of a line is none."""
        arms = [
            arm for arm in self._recorder.find_requests("arm") if (arm.step_id, arm.member) == (go.step_id, go.member)
        ]
        return bool(arms) and arms[-1].fields["start"]["chunk"] is not None

    def _expected_homing_ns(self, member: str) -> int:
        """Return the shortest expected homing time: a share of the shortest one so far, and of the path from the
        current position."""
        config = self._fleet.controllers[member]
        if find_traits(config.adapter).verifies_reference:
            return _VERIFIED_HOMING_NS
        asked_requests = (
            request for request in self._recorder.find_requests("home") if request.member == member and request.accepted
        )
        shortest_ns = min(
            request.answered_ns - request.sent_ns for request in asked_requests if request.answered_ns is not None
        )
        positions = self._find_positions()
        ways_s = (
            abs(positions[f"{member}.{name}"]) / (axis.homing.speed or axis.limits.velocity / 10)
            for name, axis in config.axes.items()
            if axis.homing.method == "default"
        )
        return round(HOMING_SHARE * (shortest_ns + max(ways_s, default=0.0) * NS_PER_S))

    def _expected_probe_ns(self, request: RecordedRequest) -> int:
        """Return how long a probe takes that touches nothing."""
        axis_name = request.fields["axes"][0]
        label = f"{request.member}.{axis_name}"
        way = self._fleet.axis(label).to_unit(request.fields["end_counts"]) - self._find_positions()[label]
        return round(abs(way) / request.fields["speed"] * NS_PER_S)

    def _expected_arming_ns(self, member: str) -> int:
        """Return the duration of the member's last arming; before the first one, a tenth of the limit that it
        declared."""
        replies = {
            request.verb: request.reply
            for request in self._recorder.requests
            if request.member == member and request.accepted
        }
        if "arm" in replies:
            return replies["arm"]["took_ns"]
        return (replies["propose"]["costs"] or {"arm_ns": 0})["arm_ns"] // 10


def _is_of_stage(request: RecordedRequest, stage: Stage) -> bool:
    """Whether a step reaches a stage by this request."""
    return request.verb == stage or (request.verb == "start-at-once" and stage in _STAGES_AT_ONCE)
