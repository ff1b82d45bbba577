"""Joint trajectories as ROS writes them: `joint_names`, and `points` with `positions` and `time_from_start`."""

from collections.abc import Mapping, Sequence
from math import isfinite
from typing import Any, cast

from orchestrator.model.jobs.files import LoadedFile
from orchestrator.model.paths.files.base.imported import format_number
from orchestrator.model.paths.files.base.problems import ImportProblems

_DERIVATIVES = ("velocities", "accelerations", "effort")


class TrajectoryReader:
    """Reads one trajectory. axes: by name of a joint, the axis of the fleet; a joint without one is an axis itself.

    Positions are in the units of their axes; ROS means radians and metres. A first point that is later than 0 is waited
    for.
    """

    def __init__(self, file: LoadedFile, axes: Mapping[str, str]) -> None:
        self._file = file
        self._given = axes
        self._problems = ImportProblems(file.name)

    def read_steps(self) -> list[dict[str, Any]]:
        """The steps of a job. Raises `FileError` with every mistake."""
        plain = _read_object(self._file.root.value)
        names, points = plain.get("joint_names"), plain.get("points")
        joints = [str(name) for name in cast(list[object], names)] if isinstance(names, list) else []
        if not joints:
            self._refuse(("joint_names",), "must be a list of names")
        rows = cast(list[object], points) if isinstance(points, list) else []
        if len(rows) < 2:
            self._refuse(("points",), f"must be a list of at least 2 points, found {len(rows)}")
        times: list[float] = []
        positions: list[list[float]] = []
        for number, row in enumerate(rows):
            self._read_point(number, row, len(joints), (times, positions))
        self._problems.raise_any()
        axes = [self._given.get(joint, joint) for joint in joints]
        begin = times[0]
        table = {"piece": "table", "t": [at - begin for at in times], "positions": positions}
        path = {"do": "path", "axes": axes, "start": positions[0], "pieces": [table]}
        return [{"do": "dwell", "duration": f"{format_number(begin)} s"}, path] if begin > 0 else [path]

    def _read_point(self, number: int, row: object, width: int, found: tuple[list[float], list[list[float]]]) -> None:
        point = _read_object(row)
        values = _read_numbers(point.get("positions"))
        if values is None or len(values) != width:
            self._refuse(("points", number, "positions"), f"must be a list of {width} numbers, one for each joint")
            return
        at_s = _read_time(point.get("time_from_start"))
        if at_s is None:
            self._refuse(("points", number, "time_from_start"), "must be seconds, or {sec: …, nanosec: …}")
            return
        self._refuse_derivatives(number, point)
        found[0].append(at_s)
        found[1].append(values)

    def _refuse_derivatives(self, number: int, point: Mapping[str, object]) -> None:
        """A path goes through its points at their times, as fast as that asks: other speeds than 0 there, and what else
        ROS may state, would be left undone."""
        for name in _DERIVATIVES:
            values = point.get(name)
            if not values or (name != "effort" and not any(_read_numbers(values) or [1.0])):
                continue
            text = "are not followed: a path has the speeds that its points and times ask for; remove them"
            self._refuse(("points", number, name), text)

    def _refuse(self, place: Sequence[str | int], text: str) -> None:
        self._problems.found.append(self._file.problem(place, text))


def _read_object(value: object) -> Mapping[str, object]:
    """An object of JSON or YAML; an empty one for anything else."""
    return cast(Mapping[str, object], value) if isinstance(value, dict) else {}


def _read_numbers(value: object) -> list[float] | None:
    if not isinstance(value, list):
        return None
    numbers = [_read_number(item) for item in cast(list[object], value)]
    return None if None in numbers else [number for number in numbers if number is not None]


def _read_number(value: object) -> float | None:
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and isfinite(value)
    return float(cast(float, value)) if is_number else None


def _read_time(value: object) -> float | None:
    if not isinstance(value, dict):
        return _read_number(value)
    parts = _read_object(cast(object, value))
    seconds = _read_number(parts.get("sec", parts.get("secs", 0)))
    more = _read_number(parts.get("nanosec", parts.get("nsecs", 0)))
    return None if seconds is None or more is None else seconds + more * 1e-9
