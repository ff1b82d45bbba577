"""Spindle, coolant and change of tools, where the job says which outputs and inputs stand for them."""

from typing import Any

from orchestrator.model.paths.files.gcode.codes import Code
from orchestrator.model.paths.files.gcode.errors import LineError
from orchestrator.model.paths.files.gcode.line import CodeLine
from orchestrator.model.paths.files.gcode.notes import SkipNotes
from orchestrator.model.paths.files.gcode.words import Word
from orchestrator.model.paths.files.gcode.writer import StepWriter
from orchestrator.model.paths.gcode_settings import CoolantOutputs, GcodeSettings, SpindleOutputs, ToolChange

NS_PER_S = 1e9


class OutputRunner:
    """Switches the outputs of the mapping; codes without one are skipped by it, or refused."""

    def __init__(self, settings: GcodeSettings, writer: StepWriter, notes: SkipNotes) -> None:
        self._settings = settings
        self._writer = writer
        self._notes = notes
        self._active = dict[str, int]()  # outputs that are on, with the wait after a change, ns

    def check_speed(self, speed: Word) -> None:
        """S: a spindle that is switched has one speed. Raises `LineError`."""
        spindle = self._settings.spindle
        if not isinstance(spindle, SpindleOutputs):
            self._notes.require_entry(self._settings, "spindle", "S", speed)
        elif spindle.speed is None:
            self._notes.skip_by_entry("S")
        elif speed.value not in (0.0, spindle.speed):
            text = f"{speed.name}: the spindle is switched on and off, and runs at {spindle.speed:g} turns a minute"
            raise LineError(speed.column, f"{text} (`gcode: {{spindle: {{speed: …}}}}`)")

    def run(self, line: CodeLine) -> None:
        """Spindle and coolant of a line. Raises `LineError`."""
        for group in ("spindle", "mist", "flood", "coolant"):
            if group in line.codes:
                code, word = line.codes[group]
                if group == "spindle":
                    self._run_spindle(code, word)
                else:
                    self._run_coolant(code, word, group)

    def change_tool(self, word: Word) -> None:
        """M6: the spindle stops, and a person changes the tool. Raises `LineError`."""
        tools = self._settings.tools
        if not isinstance(tools, ToolChange):
            self._notes.require_entry(self._settings, "tools", "M6", word)
            return
        if isinstance(self._settings.spindle, SpindleOutputs):
            self._switch_off(self._settings.spindle.outputs)
        self._writer.add_step({"do": "wait", "input": tools.change.input, "timeout": tools.change.timeout})
        self._notes.act_by_entry("M6")

    def list_active(self) -> list[dict[str, Any]]:
        """The steps that switch on what is on now."""
        steps: list[dict[str, Any]] = [{"do": "output", "output": output, "value": True} for output in self._active]
        wait_ns = max(self._active.values(), default=0)
        return [*steps, {"do": "dwell", "duration": f"{wait_ns} ns"}] if wait_ns else steps

    def end(self) -> None:
        """The end of the program switches off what is on (LinuxCNC's M2 and M30)."""
        self._switch_off(list(self._active))

    def _run_spindle(self, code: Code, word: Word) -> None:
        spindle = self._settings.spindle
        if not isinstance(spindle, SpindleOutputs):
            self._notes.require_entry(self._settings, "spindle", code.name, word)
            return
        output = {"M3": spindle.forward, "M4": spindle.reverse}.get(code.name)
        if output is None and code.name == "M4":
            raise LineError(word.column, "M4 needs `gcode: {spindle: {reverse: CONTROLLER.OUTPUT}}`")
        self._notes.act_by_entry(code.name)
        self._switch_off([name for name in spindle.outputs if name != output])
        if output is not None:
            self._switch_on(output, spindle.wait)

    def _run_coolant(self, code: Code, word: Word, group: str) -> None:
        coolant = self._settings.coolant
        if not isinstance(coolant, CoolantOutputs):
            if code.meaning == "skipped":
                self._notes.skip(code.name)
            else:
                self._notes.require_entry(self._settings, "coolant", code.name, word)
            return
        if group == "coolant":
            self._switch_off(coolant.outputs)
        else:
            output = coolant.mist if group == "mist" else coolant.flood
            if output is None:
                entry = f"`gcode: {{coolant: {{{group}: CONTROLLER.OUTPUT}}}}`"
                raise LineError(word.column, f"{code.name} needs {entry}")
            self._switch_on(output, coolant.wait)
        self._notes.act_by_entry(code.name)

    def _switch_on(self, output: str, wait_ns: int) -> None:
        if output not in self._active:
            self._active[output] = wait_ns
            self._writer.add_step({"do": "output", "output": output, "value": True})
            self._writer.add_dwell(wait_ns / NS_PER_S)

    def _switch_off(self, outputs: list[str]) -> None:
        wait_ns = 0
        for output in outputs:
            if output in self._active:
                wait_ns = max(wait_ns, self._active.pop(output))
                self._writer.add_step({"do": "output", "output": output, "value": False})
        if wait_ns:
            self._writer.add_dwell(wait_ns / NS_PER_S)
