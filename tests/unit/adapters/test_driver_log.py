"""The logs of drivers: fields of every line, refusals, and the events of a connection; and that a log changes
nothing."""

import json
from contextvars import copy_context
from typing import Any

import pytest
from unit.adapters.test_shrc203_driver import TIMING, controller

from adapters.contract import NULL_LOG, DriverLog, DriverSetup
from adapters.controller.publishing.log import ControllerLog
from adapters.shrc203 import MAKE
from adapters.toolkit.firing import LoopTimedWriter
from adapters.toolkit.refusals import log_refusals
from orchestrator.bus.log import ProcessLog
from orchestrator.clock.virtual import VirtualClock, run_virtual
from orchestrator.link.memory import MemoryWire, serial_wire
from orchestrator.model.errors import ControllerFault, Refusal
from sim.core.oscillator import Oscillator
from sim.shrc203 import SHRC203


class RecordingLog:
    """A log that keeps its lines: level, text, fields."""

    def __init__(self) -> None:
        self.lines: list[tuple[str, str, dict[str, Any]]] = []

    def info(self, text: str, **fields: Any) -> None:
        self.lines.append(("info", text, fields))

    def warning(self, text: str, **fields: Any) -> None:
        self.lines.append(("warning", text, fields))


def test_every_line_names_the_controller_and_the_epoch() -> None:
    async def main(clock: VirtualClock) -> None:
        written: list[str] = []
        log = ControllerLog(ProcessLog("controller", "a", clock, written.append), "a", lambda: 7)
        log.info("link opened", endpoint="serial a")
        log.warning("the query is repeated")
        first, second = (json.loads(line) for line in written)
        assert (first["level"], first["controller"], first["epoch"], first["endpoint"]) == ("info", "a", 7, "serial a")
        assert (second["level"], second["controller"], second["epoch"]) == ("warning", "a", 7)

    run_virtual(main)


def test_refusals_and_faults_are_logged_with_their_codes_and_raised() -> None:
    log = RecordingLog()
    with pytest.raises(Refusal, match="moving"), log_refusals(log, "arming"):
        raise Refusal("busy", "axis x is moving", "")
    with pytest.raises(ControllerFault), log_refusals(log, "arming"):
        raise ControllerFault("no-answer", "no reply", "")
    with log_refusals(log, "arming"):
        pass
    assert log.lines == [
        ("info", "arming was refused: axis x is moving", {"code": "busy"}),
        ("warning", "arming failed: no reply", {"code": "no-answer"}),
    ]


def _connect(log: DriverLog) -> tuple[int, list[bytes]]:
    """Connect to a controller; return the instant of the end and everything that was written."""
    ended: list[int] = []
    sent: list[bytes] = []

    async def main(clock: VirtualClock) -> None:
        unit = SHRC203.build_controller(clock, {}, oscillator=Oscillator(seed=1), timing=TIMING, seed=1)
        wire = MemoryWire(clock, serial_wire(38400), unit, unit.port_names[0], "serial a", copy_context(), 1)

        async def open_link() -> Any:
            link = await wire.open_link()
            write = link.write

            def record(data: bytes) -> int:
                sent.append(data)
                return write(data)

            link.write = record  # type: ignore[method-assign]
            return link

        options = MAKE.options_model.model_validate({})
        setup = DriverSetup("a", controller(), options, clock, open_link, LoopTimedWriter(clock), log=log)
        driver = MAKE.create_driver(setup)
        await driver.connect()
        await driver.configure()
        for _ in range(3):
            await driver.poll()
        ended.append(clock.now_ns())
        await driver.close()

    run_virtual(main)
    return ended[0], sent


def test_a_connection_is_logged_and_the_log_changes_nothing() -> None:
    log = RecordingLog()
    assert _connect(log) == _connect(NULL_LOG)
    texts = [text for _, text, _ in log.lines]
    assert texts[0] == "link opened"
    assert any(text.startswith("connected to SHRC-203") for text in texts)
    assert texts[-1] == "link closed"
    assert len(texts) < 8, "polls are not logged"
