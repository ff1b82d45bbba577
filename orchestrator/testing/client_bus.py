"""The bus of a client in a test: it notes jogs, which the checks need, and can lose the signs of life of commands."""

import asyncio
import json
from dataclasses import replace

from orchestrator.bus.base import Priority
from orchestrator.bus.keys import FleetKeys
from orchestrator.bus.memory.bus import MemoryBus
from orchestrator.campaign.motion_checks import JOG_END_NS
from orchestrator.campaign.recording.recorder import BusRecorder, RecordedBus
from orchestrator.campaign.records import JogRecord
from orchestrator.model.fleet import Fleet


class JogNotes:
    """The jogs of all clients."""

    def __init__(self, fleet: Fleet) -> None:
        self.jogs: list[JogRecord] = []
        self._fleet = fleet

    def note_request(self, controller: str, payload: bytes, sent_ns: int) -> None:
        """Note a jog request that may have been accepted: a new jog of its axes, or one that goes on."""
        request = json.loads(payload)
        axes = self._fleet.controllers[controller].axes if controller in self._fleet.controllers else {}
        for axis, velocity in request["velocities"].items():
            if axis in axes and velocity:
                self._note_jog(controller, axes[axis].motors[0], sent_ns)

    def _note_jog(self, controller: str, motor: str, sent_ns: int) -> None:
        for number, jog in enumerate(self.jogs):
            if (jog.controller, jog.motor) == (controller, motor) and sent_ns <= jog.renewed_ns + JOG_END_NS:
                self.jogs[number] = replace(jog, renewed_ns=max(sent_ns, jog.renewed_ns))
                return
        self.jogs.append(JogRecord(controller, motor, sent_ns, sent_ns))


class ClientBus(RecordedBus):
    """The bus session of one client. silent: its commands give no signs of life."""

    def __init__(self, bus: MemoryBus, recorder: BusRecorder, keys: FleetKeys, notes: JogNotes) -> None:
        super().__init__(bus, recorder)
        self.silent = False
        self._loop = bus.net.clock.loop
        self._keys = keys
        self._notes = notes

    async def request(self, key: str, payload: bytes, timeout_s: float, server: str | None = None) -> bytes:
        self._require_own_loop()
        *_, controller, _, verb = ["", "", *key.split("/")]
        if verb != "jog":
            return await super().request(key, payload, timeout_s, server)
        sent_ns, is_refused = self._loop.now_ns, False
        try:
            reply = await super().request(key, payload, timeout_s, server)
            is_refused = json.loads(reply)["refused"] is not None
            return reply
        finally:
            if not is_refused:
                self._notes.note_request(controller, payload, sent_ns)

    async def request_all(self, expression: str, payload: bytes, timeout_s: float) -> dict[str, bytes]:
        self._require_own_loop()
        return await super().request_all(expression, payload, timeout_s)

    def put(self, key: str, payload: bytes, priority: Priority = Priority.STATE) -> None:
        session, _, _ = self._keys.session("x").rpartition("/")
        if not (self.silent and key.startswith(f"{session}/")):
            super().put(key, payload, priority)

    def _require_own_loop(self) -> None:
        if asyncio.get_running_loop() is not self._loop:
            raise RuntimeError("a client of a virtual fleet was used in another event loop; use it inside `fleet.run`")
