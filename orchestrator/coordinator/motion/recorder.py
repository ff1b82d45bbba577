"""What a motion step was planned to do and what polls have shown of it, for plots and for those who ask why."""

from collections.abc import Mapping

from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.fleet import by_controller
from orchestrator.model.profile import Profile
from orchestrator.model.report import AxisRecording, StepRecording
from orchestrator.model.state import ControllerState

POINTS = 4000  # an axis; beyond that every second one is dropped, as often as it takes


class Recorder:
    """Records one step while it lasts: listens to the states of its members until `done`."""

    def __init__(self, view: FleetView, profiles: Mapping[str, Profile]) -> None:
        self._profiles = profiles
        self._members = by_controller(profiles)
        self._every = 1
        self._seen = 0
        self._sampled: dict[str, list[tuple[int, float]]] = {axis: [] for axis in profiles}
        self._fleet = view.fleet
        self._unlisten = view.listen_states(self._take)

    def _take(self, state: ControllerState) -> None:
        if state.read_fleet_ns is None:
            return
        for name in self._members.get(state.controller, ()):
            points = self._sampled[f"{state.controller}.{name}"]
            if points and points[-1][0] >= state.read_fleet_ns:
                continue  # the same reading, published again
            self._seen += 1
            if self._seen % self._every == 0:
                points.append((state.read_fleet_ns, state.axes[name].raw_counts))
            if len(points) >= POINTS:
                self._every *= 2
                self._sampled = {axis: kept[::2] for axis, kept in self._sampled.items()}

    def done(self, step: int, name: str, t0_fleet_ns: int) -> StepRecording:
        """The recording; nothing more is taken."""
        self._unlisten()
        axes: dict[str, AxisRecording] = {}
        for axis, profile in self._profiles.items():
            config = self._fleet.axis(axis)
            axes[axis] = AxisRecording(
                unit=config.unit,
                counts_per_unit=float(config.counts_per_unit),
                profile=profile,
                sampled=self._sampled[axis],
            )
        return StepRecording(step=step, name=name, t0_fleet_ns=t0_fleet_ns, axes=axes)
