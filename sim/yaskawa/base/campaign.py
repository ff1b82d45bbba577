"""What the fault campaign has to know of these controllers."""

from random import Random

from orchestrator.model.fleet import Controller
from sim.core.campaign import BeamCarrier, BodyCarrier, CampaignTraits, TouchInput


def _refuse_reply(data: bytes) -> bytes:
    return b"?" if data.endswith(b":") else data


def _change_one_thing(config: Controller, draw: Random, *, at_rest: bool) -> bytes:
    """Set a zero at rest, or a filter: a zero that is set in motion cannot be told from the motion."""
    motor = next(iter(config.axes.values())).motors[0]
    zero = at_rest and draw.random() < 0.5
    return f"DP{motor}=50000\r".encode() if zero else f"IT{motor}=0.02\r".encode()


_TOUCH = TouchInput(1, "low", "controller")
_TOUCH_OF_LINES = TouchInput(1, "low", "controller", line_motor="Y")
ON_ETHERNET = CampaignTraits(
    refuse_reply=_refuse_reply,
    start_class="clock",
    keeps_half_open=True,
    change_one_thing=_change_one_thing,
    touch=_TOUCH_OF_LINES,
    body=BodyCarrier(),
    beam=BeamCarrier(
        options={"watchdog_s": 0.5},
        homing={"method": "index", "speed": 0.5, "search_speed": 0.5},
        simulate={"index_every": {"X": 20, "Y": 20}},
    ),
)
IN_A_CHAIN = CampaignTraits(
    refuse_reply=_refuse_reply, start_class="clock", most_per_link=3, touch=_TOUCH, body=BodyCarrier()
)
