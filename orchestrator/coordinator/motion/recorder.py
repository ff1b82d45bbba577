"""Recording of a motion step: its plan and polled samples, for plots and for the analysis of failures."""

from collections.abc import Mapping

from orchestrator.coordinator.fleet.view import FleetView
from orchestrator.model.fleet import group_by_controller
from orchestrator.model.profile import Profile
from orchestrator.model.report import AxisRecording, StepRecording
from orchestrator.model.state import ControllerState

MAX_SAMPLES = 4000  # maximum samples of an axis; beyond that every second one is dropped, repeatedly


class StepRecorder:
    """Records the states of a step's members until `finish`."""

    def __init__(self, view: FleetView, profiles: Mapping[str, Profile]) -> None:
        self.profiles = profiles
        self._members = group_by_controller(profiles)
        self._every = 1
        self._seen = 0
        self._sampled: dict[str, list[tuple[int, float]]] = {axis: [] for axis in profiles}
        self._fleet = view.fleet
        self._unlisten = view.add_state_listener(self._add_samples, self._members)

    def _add_samples(self, state: ControllerState) -> None:
        if state.read_fleet_ns is None:
            return
        for name in self._members.get(state.controller, ()):
            points = self._sampled[f"{state.controller}.{name}"]
            if points and points[-1][0] >= state.read_fleet_ns:
                continue  # the same reading, published again
            self._seen += 1
            if self._seen % self._every == 0:
                points.append((state.read_fleet_ns, state.axes[name].raw_counts))
            if len(points) >= MAX_SAMPLES:
                self._every *= 2
                self._sampled = {axis: samples[::2] for axis, samples in self._sampled.items()}

    def close(self) -> None:
        """Stop recording."""
        self._unlisten()

    def finish(self, step: int, name: str, t0_fleet_ns: int) -> StepRecording:
        """Stop recording, and return the recording."""
        self._unlisten()
        axes: dict[str, AxisRecording] = {}
        for axis, profile in self.profiles.items():
            config = self._fleet.axis(axis)
            axes[axis] = AxisRecording(
                unit=config.unit,
                counts_per_unit=float(config.counts_per_unit),
                profile=profile,
                sampled=self._sampled[axis],
            )
        return StepRecording(step=step, name=name, t0_fleet_ns=t0_fleet_ns, axes=axes)
