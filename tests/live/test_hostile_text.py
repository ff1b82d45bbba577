"""Text that others wrote reaches a terminal only as what it is: every command that shows something is run beside it."""

import json

import pytest
from fleet import RunningFleet, run_tutti

from orchestrator.bus.base import BusError, Priority
from orchestrator.client import Tutti

pytestmark = pytest.mark.live

HOSTILE = "\x1b[31mred\r\n\u202eturned\u200b\x9b2J"
RAW = ("\x1b", "\r", "\u202e", "\u200b", "\x9b")
COMMANDS = (
    *("status", "queue status", "job ls", "axis ls", "position ls", "io ls", "alarm ls", "stats", "clock ls"),
    *("command ls", "wiring check", "trace gantry", "record ls", "job show last", "job report last"),
)


async def submit_hostile(tutti: Tutti) -> str:
    """A job with a hostile name, as any program on the bus can send it; the text of its refusal."""
    job = {"schema": "tutti.job/1", "name": HOSTILE, "steps": [{"do": "dwell", "duration": "1 s"}]}
    request = {"request_id": "r1", "actor": HOSTILE, "client_key": "k1", "job": job}
    try:
        reply = await tutti.bus.request(tutti.keys.service("submit"), json.dumps(request).encode(), 3.0)
    except BusError as error:
        return str(error)
    return reply.decode()


def test_no_command_passes_on_what_a_terminal_obeys(shared: RunningFleet) -> None:
    shared.ready()
    refusal = shared.ask(submit_hostile)
    assert "has a character that is not shown" in refusal, refusal
    shared.run([{"do": "dwell", "duration": "10 ms"}])

    async def estop(tutti: Tutti) -> None:
        message = {"event": "hostile-1", "actor": HOSTILE, "reason": HOSTILE}
        tutti.bus.put(tutti.keys.estop, json.dumps(message).encode(), Priority.ESTOP)
        latches = await tutti.wait_for_latch(5.0)
        assert latches and all(latches.values())

    shared.ask(estop)
    try:
        shown = ""
        for command in COMMANDS:
            for more in ((), ("--json",)):
                done = shared.tutti(*command.split(), *more)
                output = done.stdout + done.stderr
                assert not [sign for sign in RAW if sign in output], (command, output)
                shown += output if not more else ""
        # Both words of the stop are there, as they can be seen.
        assert "\\x1b[31mred\\r\\n\\u202eturned\\u200b\\x9b2J" in shown
        log = run_tutti("log", "--state", str(shared.state))
        assert not [sign for sign in RAW if sign in log.stdout], log.stdout
    finally:
        done = shared.tutti("reset")
    assert not [sign for sign in RAW if sign in done.stdout + done.stderr]
    shared.ready()
