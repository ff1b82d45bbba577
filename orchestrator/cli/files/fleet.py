"""`tutti fleet …`: fleet files."""

import re
import time
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED
from orchestrator.cli.base.common import fleet_options, json_option, print_json, print_result, with_fleet
from orchestrator.cli.base.errors import exit_with_error

if TYPE_CHECKING:
    from orchestrator.model.fleet import Fleet
    from orchestrator.runtime.example_fleet import MakeCount

MAX_CONTROLLERS = 32  # of an example


@click.group(epilog="Example: tutti fleet check lab3.fleet.yaml")
def fleet() -> None:
    """Check fleet files, offline and against connected controllers; load another one into the running fleet."""


@fleet.command(epilog="Example: tutti fleet check lab3.fleet.yaml --live")
@click.argument("file", type=click.Path(path_type=Path))
@click.option("--live", is_flag=True, help="Also compare with the running adapters, and with their controllers.")
@fleet_options
@json_option
def check(file: Path, connect: str, fleet: str | None, *, live: bool, as_json: bool) -> None:
    """Check FILE: its form, its references, and each controller's part by the rules of its make."""
    from orchestrator.client import Tutti

    loaded_fleet = load_or_fail(file)
    value: dict[str, Any] = {
        "fleet": loaded_fleet.fleet,
        "controllers": list(loaded_fleet.controllers),
        "axes": loaded_fleet.axis_names,
    }
    words = (
        f"{file}: {len(loaded_fleet.controllers)} controllers, {len(loaded_fleet.axis_names)} axes: no problem found"
    )
    if not live:
        print_result(value, words, as_json=as_json)
        return

    async def compare_adapters(tutti: Tutti) -> None:
        live_words: dict[str, str] = {}
        wrong = 0
        states = await tutti.status()
        for name, config in loaded_fleet.controllers.items():
            state = states.get(name)
            if state is None:
                text = "no adapter runs for it; is its host part of `tutti up`?"
            elif state.digest != config.digest:
                text = f"its adapter has another configuration ({state.digest}, the file has {config.digest})"
            elif state.faults:
                text = f"{state.faults[0].text}; {state.faults[0].remedy}"
            else:
                live_words[name] = "controller and adapter agree with the file"
                continue
            wrong += 1
            live_words[name] = text
        lines = [words, *(f"{name}: {text}" for name, text in live_words.items())]
        print_result({**value, "live": live_words}, "\n".join(lines), as_json=as_json)
        if wrong:
            raise SystemExit(FAILED)

    with_fleet(connect, fleet or loaded_fleet.fleet, compare_adapters)


@fleet.command(epilog="Example: tutti fleet expand hall.fleet.yaml > hall.json")
@click.argument("file", type=click.Path(path_type=Path))
def expand(file: Path) -> None:
    """Print the fleet file FILE as the fleet has it, as JSON, which is a fleet file too.

    `count`, `each` and `include` are carried out, tables of corrections are filled in, and defaults are written out.
    """
    print_json(load_or_fail(file).to_plain())


@fleet.command(epilog="Example: tutti fleet init --make smc4000 --make smc30:3 -o lab.fleet.yaml")
@click.option("--make", "makes", multiple=True, required=True, metavar="MAKE[:COUNT]", help="Controllers of a make.")
@click.option("-o", "--out", type=click.Path(path_type=Path), default=None, help="The file to write; default: stdout.")
@click.option("--name", default=None, help="Name of the fleet; default: the beginning of the file's name.")
@click.option("--force", is_flag=True, help="Write over an existing file.")
@json_option
def init(makes: tuple[str, ...], out: Path | None, name: str | None, *, force: bool, as_json: bool) -> None:
    """Write a commented fleet file for controllers of some makes. It passes `fleet check` and runs with `--sim`."""
    from orchestrator.runtime.example_fleet import make_example_fleet

    counts = [_parse_make(make) for make in makes]
    if sum(count.number for count in counts) > MAX_CONTROLLERS or len({count.make for count in counts}) < len(counts):
        text = f"name each make once, and at most {MAX_CONTROLLERS} controllers in all, e.g. smc30:3"
        raise click.BadParameter(text, param_hint="--make")
    file_name = "lab.fleet.yaml" if out is None else str(out)
    try:
        text = make_example_fleet(counts, name or _fleet_name_of(file_name), file_name)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--make") from None
    if out is None:
        print_json({"text": text}) if as_json else click.echo(text, nl=False)
        return
    try:
        with out.open("w" if force else "x", encoding="utf-8") as file:
            file.write(text)
    except FileExistsError:
        exit_with_error(f"{out} exists", BAD_INPUT, "choose another name, or add --force to write over it")
    except OSError as error:
        exit_with_error(f"{out} cannot be written: {error.strerror}", BAD_INPUT)
    loaded_fleet = load_or_fail(out)
    controllers, axes = len(loaded_fleet.controllers), len(loaded_fleet.axis_names)
    words = f"{out}: {controllers} controllers, {axes} axes\nnext: tutti up {out} --sim"
    print_result(
        {"file": str(out), "fleet": loaded_fleet.fleet, "axes": loaded_fleet.axis_names}, words, as_json=as_json
    )


def _parse_make(text: str) -> "MakeCount":
    from orchestrator.runtime.example_fleet import MakeCount

    make, colon, count = text.partition(":")
    if colon and not (count.isascii() and count.isdecimal() and 1 <= int(count[:6]) <= MAX_CONTROLLERS):
        raise click.BadParameter(
            f"{text!r}: the number of controllers must be 1 to {MAX_CONTROLLERS}, e.g. {make}:3", param_hint="--make"
        )
    return MakeCount(make, int(count) if colon else 1)


def _fleet_name_of(file: str) -> str:
    """The name of a fleet from that of its file: `lab` for `plant/lab.fleet.yaml`."""
    stem = re.sub(r"[^a-z0-9_-]", "-", Path(file).name.partition(".")[0].lower()).strip("-")
    return stem[:64] or "lab"


@fleet.command(epilog="Example: tutti fleet reload lab3.fleet.yaml")
@click.argument("file", type=click.Path(path_type=Path))
@fleet_options
@json_option
def reload(file: Path, connect: str, fleet: str | None, *, as_json: bool) -> None:
    """Load the fleet file FILE into the running fleet, without a restart.

    Only idle controllers that no job and no user has acquired accept another configuration; if one refuses, none
    changes. Their axes must be homed again. A controller that is added or removed, or another link, adapter or host,
    needs a new `tutti up`.
    """
    from orchestrator.client import Tutti

    loaded_fleet = load_or_fail(file)

    async def load_file(tutti: Tutti) -> None:
        changed_fleet = await tutti.reload_fleet(loaded_fleet)
        lines = [f"{name}: has the new configuration; home its axes again" for name in changed_fleet]
        print_result({"changed": changed_fleet}, "\n".join(lines) or "no controller changed", as_json=as_json)

    with_fleet(connect, fleet or loaded_fleet.fleet, load_file)


def load_or_fail(file: Path) -> "Fleet":
    """Load the checked fleet file; an invalid one ends the command with its message."""
    from orchestrator.cli.base.errors import run_main
    from orchestrator.runtime.checked import load_checked_fleet

    async def load_file() -> "Fleet":
        return load_checked_fleet(file)

    loaded_fleet = run_main(load_file())
    require_quick_maps(loaded_fleet, file)
    return loaded_fleet


def require_quick_maps(fleet: "Fleet", file: Path) -> None:
    """End the command if code of users, which maps virtual axes, answers too slowly on this computer."""
    from orchestrator.model.linear_map import MapError

    try:
        fleet.virtual_axes.check_speed(time.perf_counter)
    except MapError as error:
        exit_with_error(f"{file}: {error}", BAD_INPUT, "make its code quicker", code="bad-file")
