"""The controller acme, as the simulator reads the manual."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

from tutti.adapter.simulator import LineController, LineDevice

SEARCH_RAMP_S = 0.1  # from rest to the speed of a search


class LoadedMove(NamedTuple):
    """A move of one axis: counts, counts/s, counts/s²."""

    target: int
    speed: float
    acceleration: float


class AcmeController(LineController):
    """One controller. switches: where the reference switches are, by axis."""

    def __init__(self, device: LineDevice, switches: Mapping[str, int], search_speed: float) -> None:
        super().__init__(list(switches), device)
        self._switches = switches
        self._search_speed = search_speed
        self._loaded: dict[str, LoadedMove] = {}
        self._searching: set[str] = set()
        self._key = 0

    def reset_volatile(self) -> None:
        self._loaded.clear()
        self._searching.clear()
        self._key = 0

    def greet(self) -> str:
        return "ACME READY\n"

    def handle_rest(self) -> None:
        for name in list(self._searching):
            axis = self.axes[name]
            if not axis.is_moving:
                self._searching.discard(name)
                if round(axis.physical_position) == self._switches[name]:
                    axis.set_position(0.0)

    def handle_line(self, line: str, reply: Callable[[str], None]) -> None:
        """Execute a line; an empty one does nothing."""
        if not line:
            return
        word, *arguments = line.split(" ")
        commands: dict[str, Callable[[list[str]], str]] = {
            "ID": lambda _: "ACME MC-2 1.0 SN 4711",
            "ST": lambda _: self._report_state(),
            "KEY": self._set_key,
            "LOAD": self._load_move,
            "GO": lambda _: self._start_moves(),
            "STOP": lambda _: self._stop_all(),
            "HOME": self._search_references,
            "JOG": self._jog_axis,
            "HALT": self._halt_axis,
        }
        try:
            answer = commands[word](arguments)
        except KeyError as error:
            answer = f"ERR unknown {error}"
        except (ValueError, TypeError):
            answer = "ERR bad argument"
        reply(f"{answer}\n")

    def _report_state(self) -> str:
        moving = any(axis.is_moving for axis in self.axes.values())
        axes = " ".join(f"{n}={round(axis.position)}{'*' * axis.is_moving}" for n, axis in self.axes.items())
        return f"ST {'MOVING' if moving else 'IDLE'} {int(bool(self._loaded))} {axes}"

    def _set_key(self, arguments: list[str]) -> str:
        if arguments:
            self._key = int(arguments[0])
        return f"KEY {self._key}"

    def _load_move(self, arguments: list[str]) -> str:
        name, move = self._read_move(arguments)
        self._loaded[name] = move
        return "OK"

    def _read_move(self, arguments: list[str]) -> tuple[str, LoadedMove]:
        name, target, speed, acceleration = arguments
        move = LoadedMove(int(target), float(speed), float(acceleration))
        if not (0 < move.speed < 1e9 and 0 < move.acceleration < 1e12):
            raise ValueError(arguments)
        return self.axes[name].name, move

    def _start_moves(self) -> str:
        if not self._loaded:
            return "ERR nothing loaded"
        if any(axis.is_moving for axis in self.axes.values()):
            return "ERR moving"
        for name, move in self._loaded.items():
            self.axes[name].start_move(*move)
        self._loaded.clear()
        return "OK"

    def _stop_all(self) -> str:
        self._loaded.clear()
        for axis in self.axes.values():
            axis.brake()
        return "STOPPED"

    def _search_references(self, arguments: list[str]) -> str:
        (names,) = arguments
        for name in names:
            axis = self.axes[name]
            self._searching.add(name)
            way = self._switches[name] - axis.physical_position
            axis.start_move(axis.position + way, self._search_speed, self._search_speed / SEARCH_RAMP_S)
        self.handle_rest()
        return "OK"

    def _jog_axis(self, arguments: list[str]) -> str:
        name, move = self._read_move(arguments)
        if self.axes[name].is_moving:
            return "ERR moving"
        self.axes[name].start_move(*move)
        return "OK"

    def _halt_axis(self, arguments: list[str]) -> str:
        (name,) = arguments
        self.axes[name].brake()
        return "HALTED"
