"""`tutti fleet …`: fleet files."""

from pathlib import Path
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import FAILED
from orchestrator.cli.base.common import console, fleet_options, with_fleet

if TYPE_CHECKING:
    from orchestrator.model.fleet import Fleet


@click.group(epilog="Example: tutti fleet check lab3.fleet.yaml")
def fleet() -> None:
    """Check fleet files, offline and against connected controllers; load another one into the running fleet."""


@fleet.command(epilog="Example: tutti fleet check lab3.fleet.yaml --live")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--live", is_flag=True, help="Also compare with the running adapters, and with their controllers.")
@fleet_options
def check(file: Path, connect: str, fleet: str | None, *, live: bool) -> None:
    """Check FILE: its form, its references, and each controller's part by the rules of its make."""
    from orchestrator.client import Tutti

    loaded = load_or_fail(file)
    console.print(f"{file}: {len(loaded.controllers)} controllers, {len(loaded.axis_names)} axes: no problem found")
    if not live:
        return

    async def compare_adapters(tutti: Tutti) -> None:
        wrong = 0
        states = await tutti.status()
        for name, config in loaded.controllers.items():
            state = states.get(name)
            if state is None:
                said = "[red]no adapter runs for it[/]; is its host part of `tutti up`?"
            elif state.digest != config.digest:
                said = f"[red]its adapter has another configuration[/] ({state.digest}, the file has {config.digest})"
            elif state.faults:
                said = f"[red]{state.faults[0].text}[/]; {state.faults[0].remedy}"
            else:
                console.print(f"{name}: controller and adapter agree with the file")
                continue
            wrong += 1
            console.print(f"{name}: {said}", soft_wrap=True)
        if wrong:
            raise SystemExit(FAILED)

    with_fleet(connect, fleet or loaded.fleet, compare_adapters)


@fleet.command(epilog="Example: tutti fleet reload lab3.fleet.yaml")
@click.argument("file", type=click.Path(path_type=Path))
@fleet_options
def reload(file: Path, connect: str, fleet: str | None) -> None:
    """Load the fleet file FILE into the running fleet, without a restart.

    Only idle controllers that no job and no user has acquired accept another configuration; if one refuses, none
    changes. Their axes must be homed again. A controller that is added or removed, or another link, adapter or host,
    needs a new `tutti up`.
    """
    from orchestrator.client import Tutti

    loaded = load_or_fail(file)

    async def load_file(tutti: Tutti) -> None:
        changed = await tutti.reload_fleet(loaded)
        for name in changed:
            console.print(f"{name}: has the new configuration; home its axes again")
        if not changed:
            console.print("no controller changed")

    with_fleet(connect, fleet or loaded.fleet, load_file)


def load_or_fail(file: Path) -> "Fleet":
    """Load the checked fleet file; an invalid one ends the command with its message."""
    from orchestrator.cli.base.common import run_main
    from orchestrator.runtime.checked import load_checked_fleet

    async def load_file() -> "Fleet":
        return load_checked_fleet(file)

    return run_main(load_file())
