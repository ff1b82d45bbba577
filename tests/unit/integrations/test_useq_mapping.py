"""What is written for the parts of a microscope."""

import pytest

from integrations.useq.mapping import BadMapping, read_mapping


def test_entries_are_axes_a_camera_and_channels() -> None:
    mapping = read_mapping(["x=gantry.x, y=gantry.y", "camera=gantry.lamp,channel.DAPI=gantry.laser"], ["autofocus"])
    assert mapping.axes == {"x": "gantry.x", "y": "gantry.y"} and mapping.camera == "gantry.lamp"
    assert mapping.channels == {"DAPI": "gantry.laser"} and mapping.ignored == {"autofocus"}


@pytest.mark.parametrize(
    ("entries", "said"),
    [
        (["x"], "no entry"),
        (["x=gantry"], "no entry"),
        (["x=gantry.x,x=gantry.y"], "already"),
        (["camera=a.b,camera=a.c"], "already"),
        (["x=gantry.x,y=gantry.x"], "two coordinates"),
        (["shutter=gantry.lamp"], "no sequence has 'shutter'"),
        (["channel.=gantry.lamp"], "no sequence has"),
    ],
)
def test_an_entry_that_cannot_be_used_is_named(entries: list[str], said: str) -> None:
    with pytest.raises(BadMapping) as refused:
        read_mapping(entries, [])
    assert said in refused.value.text and refused.value.remedy
