"""Scans that fly: which lines are flown in one motion, and where a flight that was interrupted goes on."""

from dataclasses import dataclass

from orchestrator.coordinator.motion.path_chunks import make_chunk_ability
from orchestrator.coordinator.motion.services import MotionServices
from orchestrator.model.steps.kinds import Motion
from orchestrator.model.steps.order import StepPlace
from orchestrator.model.steps.scan import Scan
from orchestrator.plan.flying.line_plan import plan_lines
from orchestrator.plan.flying.lines import FlownLines
from orchestrator.plan.flying.path import FlightPath, FlownPart, choose_part, list_members

MOST_STOPS = 3
"""Of one scan, because chunks came too late, after which it ends."""
SCANS_KEPT = 2  # the present one, and one that is looked at ahead


@dataclass(slots=True)
class _FlownScan:
    """A scan whose lines are flown. part: what is flown next in one motion, None: its lines are flown one by one.
    begin: the point from which an interrupted line is flown again. stops: how often chunks came too late."""

    lines: FlownLines
    part: FlownPart | None = None
    begin: int | None = None
    stops: int = 0

    def is_in_line(self, point: int | None, begin: int) -> bool:
        """Whether a point is in the line that begins with another one."""
        return point is not None and point - point % self.lines.count == begin


class ScanFlights:
    """The flights of one job, one scan after the other."""

    def __init__(self, services: MotionServices) -> None:
        self._services = services
        self._fleet = services.fleet.view.fleet
        self._scans: dict[int, _FlownScan] = {}
        self._next_index: int | None = None

    def find_lines(self, place: StepPlace) -> FlownLines | None:
        """The lines of the scan that a step belongs to, if it flies. Raises `Refusal` if it cannot be flown."""
        scan = place.scan
        return None if scan is None or scan.fly is None else self._find_scan(place, scan).lines

    def _find_scan(self, place: StepPlace, scan: Scan) -> _FlownScan:
        scan_state = self._scans.get(place.first)
        if scan_state is None or scan_state.lines.scan is not scan:
            if len(self._scans) == SCANS_KEPT:
                del self._scans[next(iter(self._scans))]
            self._scans[place.first] = scan_state = _FlownScan(plan_lines(scan, self._fleet))
        return scan_state

    async def prepare(self, place: StepPlace) -> None:
        """Plan what is flown from a line on, before the move to its beginning. Raises `Refusal`."""
        if place.scan is None or place.scan.fly is None or place.point is None:
            return
        scan_state = self._find_scan(place, place.scan)
        if place.part and scan_state.part is not None and scan_state.is_in_line(scan_state.part.first, place.point):
            return
        scan_state.part = await self._plan_part(scan_state.lines, self.find_begin(place))

    def find_begin(self, place: StepPlace) -> int:
        """The point from which the line of a step is flown: its first one, but of one that was interrupted."""
        assert place.point is not None
        begin = self._scans[place.first].begin
        is_inside = begin is not None and self._scans[place.first].is_in_line(begin, place.point)
        return begin if begin is not None and is_inside else place.point

    def find_motion(self, place: StepPlace) -> Motion:
        """The motion of a step of a scan that flies: to where a line begins, or through its windows, and those of the
        lines behind it that are flown with it. Raises `Refusal`."""
        assert place.scan is not None and place.point is not None
        scan_state = self._find_scan(place, place.scan)
        lines, part = scan_state.lines, scan_state.part
        if part is None or not scan_state.is_in_line(part.first, place.point):
            return lines.make_path(place.point) if place.is_flown_path else lines.make_move(place.point)
        return FlightPath.make(part) if place.is_flown_path else lines.make_move(part.first)

    async def _plan_part(self, lines: FlownLines, first: int) -> FlownPart | None:
        """The lines from a point on that are flown in one motion; None where they are flown one by one. Raises
        `Refusal` for an absent member."""
        view = self._services.fleet.view
        abilities = {name: make_chunk_ability(await view.infos.require(name)) for name in list_members(lines)}
        part, reason = await self._services.plan(choose_part, lines, self._fleet, first, abilities)
        if part is None:
            self._services.fleet.log.info(f"flown line by line: {reason}")
        return part

    # Ends

    def note_end(self, place: StepPlace, next_point: int) -> None:
        """A flight has ended, as planned or braked on its way: the points from `next_point` on are flown next."""
        scan_state = self._scans[place.first]
        count = scan_state.lines.count
        self._next_index = place.first + next_point // count * scan_state.lines.scan.points_steps
        scan_state.begin = next_point if next_point % count else None
        scan_state.part = None

    def note_stop(self, place: StepPlace) -> str:
        """A chunk came too late; return why the scan does not go on, empty: it does."""
        scan_state = self._scans[place.first]
        scan_state.stops += 1
        return "" if scan_state.stops <= MOST_STOPS else f"that was stop {scan_state.stops} of the scan, which ends"

    def repeats_disturbed(self, place: StepPlace) -> bool:
        """Whether windows that were disturbed because a chunk came too late are flown again."""
        scan_state = self._scans[place.first]
        return scan_state.lines.scan.fly is not None and scan_state.stops <= scan_state.lines.scan.fly.repeat_disturbed

    @property
    def goes_on(self) -> bool:
        """Whether a flight has ended behind which the scan goes on."""
        return self._next_index is not None

    def take_next(self, index: int) -> int:
        """The number of the next step, where `index` would be without flights."""
        next_index, self._next_index = self._next_index, None
        return index if next_index is None else next_index
