"""Wires from the outputs of a live simulator to the inputs of others, which run in processes of their own."""

import json
import os
from collections.abc import Sequence

from orchestrator.clock.base import NS_PER_US, Clock
from orchestrator.model.files.private_files import open_private_file
from sim.core.controller import SimulatedController
from sim.link.arguments import WireFields


def follow_outputs(controller: SimulatedController, wires: Sequence[WireFields], clock: Clock) -> None:
    """Make each wire's far end follow its output from now on. An absent receiver misses the change."""

    def forward_change(output: int, *, on: bool) -> None:
        for wire in wires:
            if wire.output == output:
                line = json.dumps({"input": [wire.input, on == wire.level_when_on]}).encode() + b"\n"
                clock.call_at_ns(
                    clock.now_ns() + wire.delay_us * NS_PER_US, lambda w=wire, text=line: _send_change(w, text)
                )

    if wires:
        controller.on_output(lambda output, on: forward_change(output, on=on))


def _send_change(wire: WireFields, line: bytes) -> None:
    try:
        pipe = open_private_file(wire.world, os.O_WRONLY | os.O_NONBLOCK)
    except OSError:
        return
    with os.fdopen(pipe, "wb", buffering=0) as world:
        world.write(line)
