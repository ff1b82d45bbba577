"""What the fault campaign has to know of these drives."""

from dataclasses import replace
from random import Random

from orchestrator.link.can import CanFrame, decode_frames, encode_frames
from orchestrator.model.fleet import CanBusLink, Controller
from sim.core.campaign import BeamCarrier, BodyCarrier, CampaignTraits, TouchInput


def _refuse_reply(data: bytes) -> bytes:
    """Replace replies to SDOs by aborts: "data cannot be transferred because of the present device state"."""
    abort = (0x0800_0022).to_bytes(4, "little")
    return encode_frames(
        *(
            replace(frame, data=b"\x80" + frame.data[1:4] + abort) if frame.id & ~0x7F == 0x580 else frame
            for frame in decode_frames(data)
        )
    )


def _change_one_thing(config: Controller, draw: Random, *, at_rest: bool) -> bytes:
    """SDO: write 500 to the home offset, 607Ch."""
    del draw, at_rest
    assert isinstance(config.link, CanBusLink)
    data = bytes.fromhex("237c6000") + (500).to_bytes(4, "little")
    return encode_frames(CanFrame(0x600 + config.link.address, data))


CAMPAIGN = CampaignTraits(
    refuse_reply=_refuse_reply,
    most_per_link=2,
    start_class="sync",
    starts_link_together=True,
    change_one_thing=_change_one_thing,
    touch=TouchInput(2, "high", "computer"),
    body=BodyCarrier({"method": "28"}, {"home_switch": [-4000, -500]}),
    beam=BeamCarrier(
        options={"watchdog_ms": 500},
        homing={"method": "index_negative", "speed": 0.5, "search_speed": 0.5},
        simulate={"index_every": 20},
    ),
)
