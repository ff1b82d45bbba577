"""The motor record of one axis: what a put to each field does, and when it ends. It knows neither protocol nor fleet.

Semantics: motorRecord.html and motorRecord.cc of EPICS motor R7-3; `tests/contract/vectors/motor_record.jsonl` has
sequences with their sources. It differs where a fleet differs: no position is loaded into a controller, and nothing
waits in SPMG Stop or Pause but a target.
"""

from collections.abc import Callable
from functools import partial
from typing import Protocol

from integrations.epics.fields import FIELDS, GO, MOVE, PAUSE, STOP, Value
from integrations.epics.readings import AxisReading
from integrations.epics.values import JOG_MARGIN_S, Done, MotorValues
from tutti import AxisInfo, Refusal

DRIVES, JOGS, HOMES = ("VAL", "DVAL", "RVAL", "TWF", "TWR"), ("JOGF", "JOGR"), ("HOMF", "HOMR")


class AxisDriver(Protocol):
    """Moves one axis. Each call begins an operation and returns at once; `MotorRecord.end` ends each of them once.
    `move` during a move sends the axis elsewhere, as part of the same operation."""

    def move(self, target: float, velocity: float) -> None: ...
    def jog(self, velocity: float) -> None: ...
    def home(self) -> None: ...
    def set_position(self, position: float) -> None: ...
    def enable(self, *, on: bool) -> None: ...
    def stop(self) -> None:
        """End the present operation early; without one, stop what else moves the axis."""
        ...


class MotorRecord(MotorValues):
    """The record of the axis `info`. velocity: VELO until it is put, unit/s."""

    def __init__(self, info: AxisInfo, first: AxisReading, velocity: float, driver: AxisDriver) -> None:
        super().__init__(info, first, velocity)
        self._driver = driver
        self._waiting: list[Done] = []
        self._operation = ""  # move, jog, home, set, motor
        self._stopping = ""  # stop, pause
        self._is_pending = False  # a target waits to be gone to
        self._following: Callable[[], None] | None = None  # what begins when the present operation has ended
        self.read(first)

    # Puts

    def put(self, name: str, raw: object, done: Done) -> None:
        """Put a field. `done` is called once: at once, or at the end of the motion that the put begins."""
        try:
            value = FIELDS[name].convert(f"{self.axis}.{name}", raw)
            if name in DRIVES:
                is_waiting = self._put_drive(name, float(value), done)
            elif name in JOGS:
                is_waiting = self._put_jog(name, done, on=bool(value))
            elif name in HOMES or name in ("OFF", "CNEN"):
                is_waiting = self._put_operation(name, float(value), done)
            else:
                is_waiting = self._put_setting(name, value)
        except Refusal as error:
            done(f"{error.text}; {error.remedy}" if error.remedy else error.text)
            return
        if not is_waiting:
            done(None)

    def _put_drive(self, name: str, value: float, done: Done) -> bool:
        if name in ("TWF", "TWR") and not value:
            return False
        offset, tweak = self._number("OFF"), self._number("TWV") * (1 if name == "TWF" else -1)
        target = {"VAL": value, "DVAL": value + offset, "RVAL": value * self._number("MRES") + offset}.get(
            name, self._number("VAL") + tweak
        )
        self._set("DMOV", 0)
        try:
            if self.values["SET"]:
                self._recalibrate(name, target)
            else:
                self._aim(target)
        except Refusal:
            self._set("DMOV", int(not (self._operation or self._is_pending)))
            raise
        self._waiting.append(done)
        self._settle()
        return True

    def _aim(self, target: float) -> None:
        """Take a target, and go there as soon as the axis may. Raises `Refusal`, and keeps the one before."""
        self._set("LVIO", int(self._is_outside(target)))
        if self.values["LVIO"]:
            limits = f"{self._number('LLM'):.10g} to {self._number('HLM'):.10g} {self.values['EGU']}"
            text = f"{self.axis}: {target:.10g} is outside its limits, {limits}"
            raise Refusal("soft-limit", text, "put a position between them")
        self._set_target(target)
        if self.values["SPMG"] in (MOVE, GO) and self._operation:
            if self._operation == "move" and not self._stopping:
                self._go()
                return
            if self._operation == "jog" and not self._stopping:
                self._stop("stop")
            self._following = self._go
        else:
            self._is_pending = True

    def _settle(self) -> None:
        """Go to a target that waits, if the axis may; end its put if the axis is there."""
        if self._is_pending and not self._operation:
            distance = abs(self._number("VAL") - self._number("RBV"))
            if not self.values["MOVN"] and distance < self._number("MRES") / 2:
                self._is_pending = False
                self._finish(None)
            elif self.values["SPMG"] in (MOVE, GO):
                self._go()

    def _recalibrate(self, name: str, target: float) -> None:
        self._require_rest(name)
        if self.values["FOFF"] or name in ("DVAL", "RVAL"):
            text = f"{self.axis}: no position is loaded into its controller; only homing changes its dial position"
            raise Refusal("not-possible", text, "set FOFF to Variable, and put VAL")
        self._set_target(target)
        self._begin("set", partial(self._driver.set_position, target))

    def _put_jog(self, name: str, done: Done, *, on: bool) -> bool:
        if not on:
            if self.values[name] and self._operation == "jog":
                self._stop("stop")
            self._set(name, 0)
            return False
        self._require_go(name)
        if self._is_near_limit(1 if name == "JOGF" else -1):
            self._set("LVIO", 1)
            text = f"{self.axis} is less than the way of {JOG_MARGIN_S:g} s at VELO from its limit"
            raise Refusal("soft-limit", text, "put a smaller VELO, or jog the other way")
        is_same = bool(self.values[name])
        self._set("DMOV", 0)
        self._set("LVIO", 0)
        self._set("JOGR" if name == "JOGF" else "JOGF", 0)
        self._set(name, 1)
        self._waiting.append(done)
        if not is_same or self._stopping:
            self._replace(self._begin_jog)
        return True

    def _begin_jog(self) -> None:
        if direction := self._jog_direction:
            self._begin("jog", partial(self._driver.jog, direction * self._number("VELO")))
        else:  # released meanwhile
            self._sync()
            self._finish(None)

    def _put_operation(self, name: str, value: float, done: Done) -> bool:
        if name in HOMES:
            if not value:
                raise Refusal("bad-value", f"{self.axis}: {name} cannot be 0", "put STOP to end the search")
            self._require_go(name)
            self._set("DMOV", 0)
            self._set(name, 1)
            self._replace(partial(self._begin, "home", self._driver.home))
        else:
            self._require_rest(name)
            if name == "OFF":
                self._begin("set", partial(self._driver.set_position, self._number("DRBV") + value))
            else:
                self._begin("motor", partial(self._driver.enable, on=bool(value)))
        self._waiting.append(done)
        return True

    def _put_setting(self, name: str, value: Value) -> bool:
        if name == "VELO" and not 0 < float(value) <= self._number("VMAX"):
            text = f"{self.axis}: VELO is above 0, and at most VMAX, {self._number('VMAX'):.10g} {self.values['EGU']}/s"
            raise Refusal("bad-value", text, "put one of these")
        if name in ("LLM", "HLM", "DLLM", "DHLM"):
            self._put_limit(name, float(value))
        elif name == "SPMG":
            self._put_spmg(int(value))
        elif name != "STOP":
            self._set(name, value)
        elif value:
            self._take_back()
        return False

    def _put_limit(self, name: str, value: float) -> None:
        """Limits for the clients of this record, within those of the fleet."""
        dial, margin = value - (0 if name.startswith("D") else self._number("OFF")), self._number("MRES") / 1000
        low, high = self._fleet_limits or (1.0, 0.0)
        if not low - margin <= dial <= high + margin:
            text = f"{self.axis}: {name} is not within the soft limits of the fleet file"
            raise Refusal("soft-limit", text, "put a limit within them, or change the file")
        self._set(f"D{name[-3:]}", dial)
        self._set_user_limits()
        self._set("LVIO", int(self._is_outside(self._number("VAL"))))

    def _put_spmg(self, choice: int) -> None:
        self._set("SPMG", choice)
        if choice == STOP:
            self._take_back()
        elif choice == PAUSE and self._operation and not self._stopping:
            self._stop("pause" if self._operation == "move" else "stop")
        else:
            self._settle()

    def _take_back(self) -> None:
        """STOP, or SPMG Stop: nothing moves, and nothing waits."""
        if self._is_pending and not self._operation:
            self._is_pending = False
            self._sync()
            self._finish(None)
        else:
            self._stop("stop")

    # Operations

    def read(self, reading: AxisReading) -> None:
        """Take a reading, unless it is older than the one before."""
        if (reading.fleet_ns or 0) < (self.reading.fleet_ns or 0) and reading.fleet_ns is not None:
            return
        self._take(reading)
        if self._operation == "jog" and not self._stopping and self._is_near_limit(self._jog_direction):
            self._set("LVIO", 1)
            self._stop("stop")
        is_free = reading.online and not (self._operation or self._is_pending or reading.moving)
        if is_free and abs(reading.commanded - self._number("VAL")) > self._number("MRES"):
            self._set_target(reading.commanded)  # another client of the fleet has moved it

    def end(self, error: str | None = None) -> None:
        """The present operation has ended, with the axis at rest. error: why it was not done; None also for one that
        was stopped."""
        operation, way, following = self._operation, self._stopping, self._following
        self._operation, self._stopping, self._following = "", "", None
        if error is not None or following != self._begin_jog:
            for name in {"jog": JOGS, "home": HOMES}.get(operation, ()):
                self._set(name, 0)
        if error is None and following is not None:
            following()
        elif error is None and way == "pause":
            self._is_pending = True
            self._settle()
        else:
            if operation == "move" and error is None and not way:
                self._set("SPMG", PAUSE if self.values["SPMG"] == MOVE else self.values["SPMG"])
            elif operation != "motor":
                self._sync()
            self._finish(error)

    def _begin(self, operation: str, start: Callable[[], None]) -> None:
        self._operation = operation
        start()

    def _replace(self, begin: Callable[[], None]) -> None:
        """Begin an operation, after the one that it ends."""
        if self._operation:
            self._stop("stop")
            self._following = begin
        else:
            begin()

    def _go(self) -> None:
        self._is_pending, self._operation = False, "move"
        self._driver.move(self._number("VAL"), self._number("VELO"))

    def _stop(self, how: str) -> None:
        self._stopping, self._following = how if self._operation else "", None
        self._driver.stop()

    def _finish(self, error: str | None) -> None:
        self._problem = error or ""
        self._update_alarm()
        self._set("DMOV", 1)
        puts, self._waiting = self._waiting, []
        for end_put in puts:
            end_put(error)

    def _require_rest(self, name: str) -> None:
        if self._operation or self._is_pending:
            raise Refusal("moving", f"{self.axis}: {name} is put at rest only", "wait until DMOV is 1, or put STOP")

    def _require_go(self, name: str) -> None:
        if self._operation in ("home", "set", "motor") or self.values["SET"]:
            raise Refusal("busy", f"{self.axis}: {name} is not possible while SET is Set, or another one goes on", "")
        if self.values["SPMG"] in (STOP, PAUSE):
            raise Refusal("paused", f"{self.axis}: SPMG is Stop or Pause", "put Go")
