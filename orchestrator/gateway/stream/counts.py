"""How many controllers are in which mode, and which are in trouble: what a view of many always has."""

from collections import Counter
from collections.abc import Iterable, Mapping
from typing import Any

from orchestrator.model.operation.troubles import TROUBLES, Trouble, find_trouble
from orchestrator.model.state import ControllerState

MAX_TROUBLED = 50  # names of each trouble that are shown


class FleetCounts:
    """Takes each state that was parsed; `show` costs what has changed, not the fleet."""

    def __init__(self) -> None:
        self._modes: dict[str, str] = {}
        self._count: Counter[str] = Counter()
        self._troubled: dict[str, Trouble] = {}
        self._silent: set[str] = set()
        self._shown: dict[str, Any] | None = None

    def take_state(self, name: str, state: ControllerState) -> None:
        """Count a state in place of the one before."""
        mode_before, self._modes[name] = self._modes.get(name), state.mode
        trouble, trouble_before = find_trouble(state), self._troubled.get(name)
        if (mode_before, trouble_before) == (state.mode, trouble):
            return
        self._shown = None
        self._count[state.mode] += 1
        if mode_before is not None:
            self._count[mode_before] -= 1
        if trouble is None:
            self._troubled.pop(name, None)
        else:
            self._troubled[name] = trouble

    def take_silent(self, names: Iterable[str]) -> None:
        """Take which controllers have published nothing for too long."""
        silent_names = set(names)
        if silent_names != self._silent:
            self._silent, self._shown = silent_names, None

    def forget(self, name: str) -> None:
        """A controller is no longer in the fleet."""
        mode = self._modes.pop(name, None)
        if mode is not None:
            self._count[mode] -= 1
        self._troubled.pop(name, None)
        self._silent.discard(name)
        self._shown = None

    def show(self, configured: int) -> Mapping[str, Any]:
        """configured: controllers of the fleet file."""
        shown_counts = self._shown
        if shown_counts is None or shown_counts["configured"] != configured:
            shown_counts = self._shown = self._make(configured)
        return shown_counts

    def _make(self, configured: int) -> dict[str, Any]:
        trouble_by_name: dict[str, Trouble] = {**self._troubled, **dict.fromkeys(self._silent, "silent")}
        names_by_trouble: dict[Trouble, list[str]] = {trouble: [] for trouble in TROUBLES}
        for name, trouble in sorted(trouble_by_name.items()):
            names_by_trouble[trouble].append(name)
        return {
            "configured": configured,
            "controllers": len(self._modes),
            "modes": {mode: count for mode, count in sorted(self._count.items()) if count},
            "troubles": {trouble: len(names) for trouble, names in names_by_trouble.items() if names},
            "troubled": {name: trouble for trouble, names in names_by_trouble.items() for name in names[:MAX_TROUBLED]},
        }
