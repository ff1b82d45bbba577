"""A simulated SMC-4000 with a client at its port, on virtual time."""

from orchestrator.clock.queue import EventQueue
from sim.core.controller import FirmwareTiming
from sim.core.oscillator import Oscillator
from sim.yaskawa import SMC4000
from sim.yaskawa.smc4000 import WITHOUT_DELAYS


class Desk:
    """One controller with an open connection, on virtual time."""

    def __init__(
        self,
        port: str = "tcp",
        timing: FirmwareTiming | None = None,
        oscillator: Oscillator | None = None,
        clock: EventQueue | None = None,
        **options: object,
    ) -> None:
        self.clock = clock or EventQueue()
        self.unit = SMC4000.build_controller(self.clock, WITHOUT_DELAYS | options, timing=timing, oscillator=oscillator)
        self.heard = b""
        self.hung_up = False
        self.open(port)

    def open(self, port: str) -> None:
        def closed() -> None:
            self.hung_up = True

        self.line = self.unit.connect(port, self._hear, closed)

    def _hear(self, data: bytes) -> None:
        self.heard += data

    def ask(self, *commands: str, wait_s: float = 0.0) -> str:
        for command in commands:
            self.heard = b""
            self.line.receive_bytes((command if command.endswith(("\r", "\x1a")) else f"{command}\r").encode("latin-1"))
            self.wait(wait_s)
        return self.heard.decode("latin-1")

    def wait(self, seconds: float) -> None:
        self.clock.run_until_ns(self.clock.now_ns() + round(seconds * 1e9))

    def rest(self) -> None:
        while not self.unit.at_rest():
            assert self.clock.make_next_call()
