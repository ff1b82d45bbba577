"""Which axes the jog panel shows, by the names that are given to it."""

import pytest
from cluster.worlds import run_fleet, virtual_demo_fleet

from orchestrator.cli.manual.jog import jog
from orchestrator.runtime.virtual.fleet import VirtualFleet

find_axes = jog._find_configurations  # pyright: ignore[reportPrivateUsage]


@pytest.mark.parametrize(
    ("name", "text"),
    [
        ("turned.u", "turned.u is virtual, and this panel jogs real axes"),
        ("turned", "turned is virtual"),
        ("gantry.q", "no axis or controller 'gantry.q'; the axes are: gantry.x"),
    ],
)
def test_names_that_it_cannot_jog_are_refused(name: str, text: str, capsys: pytest.CaptureFixture[str]) -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        assert list(await find_axes(client, ("gantry",))) == ["gantry.x", "gantry.y"]
        with pytest.raises(SystemExit) as ended:
            await find_axes(client, (name,))
        assert ended.value.code == 2

    run_fleet(main, virtual_demo_fleet())
    assert text in capsys.readouterr().err
