"""What virtual and live fleets have in common: begin and end, and their environment by the names of the fleet file."""

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Self, get_args

from orchestrator.model.fleet import Fleet
from orchestrator.model.units import parse_quantity
from orchestrator.testing import open_fleets
from orchestrator.testing.errors import (
    BadTest,
    CallbackFailed,
    find_axis,
    find_choice,
    find_input,
    format_s,
    parse_delay_ns,
)
from sim.core.controller import LimitSwitch


class FleetTestbed(ABC):
    """A simulated fleet; use it as a context.

    fleet: its fleet file. origin_ns: host time at which fleet time is 0.
    """

    def __init__(self, fleet: Fleet, *, check: bool) -> None:
        self.fleet = fleet
        self.origin_ns = 0
        self._check = check
        self._started = False
        self._ended = False

    # Begin and end

    def __enter__(self) -> Self:
        """Start it: when this returns, every controller is adopted and idle. Does nothing to one that runs.

        Raises `BadTest` for one that has ended."""
        if self._ended:
            raise BadTest("the fleet has ended; make another one")
        if not self._started:
            self._started = True
            open_fleets.add(self)
            try:
                self._start()
            except BaseException:
                self.close()
                raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        """Check it, unless an error has left the context, and end it. Raises `FleetViolation`."""
        if kind is None:
            self.check_and_close()
        else:
            self.close()

    def check_and_close(self) -> None:
        """Check it, unless `check=False` was given, and end it. Raises `FleetViolation`."""
        try:
            if self._check and self._started and not self._ended:
                self.check()
        finally:
            self.close()

    def close(self) -> None:
        """End it without a check. May be called twice."""
        open_fleets.discard(self)
        if not self._ended:
            self._ended = True
            self._end()

    @abstractmethod
    def check(self) -> None:
        """Check what has happened. Raises `FleetViolation`."""

    @abstractmethod
    def _start(self) -> None: ...

    @abstractmethod
    def _end(self) -> None: ...

    # The physical environment, now or at a time from now

    def schedule(self, function: Callable[[], object], at: str | float) -> None:
        """Call `function` at a time from now, by text with a unit or by seconds. An error in it fails the test as
        `CallbackFailed`."""
        self._call_at(function, parse_delay_ns("at", at))

    def set_input(self, name: str, *, on: bool, at: str | float | None = None) -> None:
        """Make the input `controller.input` active or passive, whatever its polarity. Raises `UnknownName`."""
        controller, wired_input = find_input(self.fleet, name)
        self._change(controller, {"input": [wired_input.number, on == (wired_input.active == "high")]}, at)

    def press_limit(self, axis: str, which: LimitSwitch, *, at: str | float | None = None) -> None:
        """Press limit switches of an axis: `forward`, `reverse` (of its motor), `both`, or `none`. Raises
        `UnknownName`."""
        controller, config = find_axis(self.fleet, axis)
        find_choice("limit switch", which, get_args(LimitSwitch))
        self._change(controller, {"limit": [config.motors[0], which]}, at)

    def stall_axis(self, axis: str, *, stalled: bool = True, at: str | float | None = None) -> None:
        """Stall an axis, so that it does not follow its command; or free it. Raises `UnknownName`."""
        controller, config = find_axis(self.fleet, axis)
        self._change(controller, {"stall": [config.motors[0], stalled]}, at)

    def put_contact(self, name: str, axis: str, distance: str | float | None, *, at: str | float | None = None) -> None:
        """Make the input `controller.input` active where an axis of the same controller is so far from its present
        place, and beyond: for a probe. distance: in the axis's unit, or text with one; None removes the contact. Raises
        `UnknownName`."""
        controller, wired_input = find_input(self.fleet, name)
        _, config = find_axis(self.fleet, axis)
        counts = 0 if distance is None else float(parse_quantity(distance, config.unit) * config.counts_per_unit)
        contact = [config.motors[0], counts, wired_input.number, wired_input.active == "high"]
        self._change(controller, {"contact": contact}, at)

    def _change(self, controller: str, change: dict[str, object], at: str | float | None) -> None:
        self._call_at(lambda: self._change_now(controller, change), parse_delay_ns("at", at))

    @abstractmethod
    def _call_at(self, function: Callable[[], object], at_ns: int | None) -> None:
        """Call it now, or at `at_ns` from now."""

    @abstractmethod
    def _change_now(self, controller: str, change: dict[str, object]) -> None:
        """Change the environment of a controller, as a line of `sim/link/world.py` does."""


def call_scheduled(function: Callable[[], object], due_ns: int) -> None:
    """Call a function of a test that was scheduled for `due_ns`, in fleet time. Raises `CallbackFailed`."""
    try:
        function()
    except Exception as error:
        name = getattr(function, "__name__", repr(function))
        text = f"{name}, scheduled for {format_s(due_ns)}, has raised {type(error).__name__}: {error}"
        raise CallbackFailed(text) from error
