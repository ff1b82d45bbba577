"""`tutti sim serve`: simulated controllers alone, for other people's drivers."""

import asyncio
import json
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import click

from orchestrator.cli.base.codes import BAD_INPUT, FAILED, INTERRUPTED
from orchestrator.cli.base.common import json_option, print_result
from orchestrator.cli.base.errors import errors, exit_with_error, run_main
from orchestrator.cli.base.systems import require_unix
from orchestrator.clock.signals import call_at_signals

if TYPE_CHECKING:
    from orchestrator.model.fleet import Fleet
    from orchestrator.runtime.live.served import LinkKind

MAX_CONTROLLERS = 32


@click.command(
    epilog="""\b
Examples:
  tutti sim serve smc4000 --port 5000
  tutti sim serve smc30 --number 3
  tutti sim serve shrc203 --link tcp --truth
  tutti sim serve --fleet lab.fleet.yaml --state /tmp/lab

\b
Exit codes: 0 ended by Ctrl-C or SIGTERM; 130 the same before all listened;
1 a simulator could not be started, or ended; 2 bad input."""
)
@click.argument("model", required=False)
@click.option("--fleet", "file", type=click.Path(path_type=Path), default=None, help="Serve the controllers of a file.")
@click.option(
    "--number", default=None, type=click.IntRange(1, MAX_CONTROLLERS), help="Of controllers; a make may share a line."
)
@click.option(
    "--link",
    "kind",
    type=click.Choice(["tcp", "udp", "serial"]),
    default=None,
    help="Each on a link of this kind; a model without Ethernet is behind a serial bridge then.",
)
@click.option(
    "--port",
    default=0,
    type=click.IntRange(0, 65_535),
    help="The first TCP or UDP port of 127.0.0.1; the next ones count up. Default: free ones.",
)
@click.option("--options", default="{}", metavar="JSON", help="Options of the simulator, as in `simulate.options`.")
@click.option("--state", type=click.Path(path_type=Path), default=None, help="Folder for `tutti sim … --state`.")
@click.option("--truth", is_flag=True, help="Write true motions to STATE/truth, one JSON object a line.")
@json_option
def serve(
    model: str | None,
    file: Path | None,
    number: int | None,
    kind: "LinkKind | None",
    port: int,
    options: str,
    state: Path | None,
    *,
    truth: bool,
    as_json: bool,
) -> None:
    """Serve simulated controllers of MODEL, or those of a fleet file, without adapters and without a bus.

    For drivers of your own: it prints where each listens (TCP, UDP, pseudo-terminals, slcan), and a folder; with
    `--state FOLDER`, `tutti sim input|limit|power|push|stall` change their environment. Ctrl-C ends it.
    """
    from orchestrator.runtime.live.fleet import LiveFleet
    from orchestrator.runtime.live.run import FleetRun
    from orchestrator.runtime.live.served import describe_links
    from orchestrator.runtime.state.folder import default_state

    def print_line(line: str) -> None:
        errors.print(line, highlight=False, markup=False, soft_wrap=True)

    async def run_simulators() -> None:
        fleet = _find_fleet(model, file, number, options, kind)
        if any(config.link.kind in ("serial", "can") for config in fleet.controllers.values()):
            require_unix("a serial line or CAN bus that is simulated", "serve it on Ethernet: --link tcp")
        folder = (state or default_state(fleet.fleet if model else f"sim-{fleet.fleet}")).absolute()
        run = FleetRun(simulated=True, truth=truth, first_port=port)
        live = LiveFleet(fleet, folder, lambda _: None, run)
        end = asyncio.Event()
        loop = asyncio.get_running_loop()
        call_at_signals(end.set)
        starting, ended_task = loop.create_task(live.start_simulators()), loop.create_task(end.wait())
        await asyncio.wait([starting, ended_task], return_when=asyncio.FIRST_COMPLETED)
        if not starting.done():
            starting.cancel()
            await asyncio.wait([starting])
            raise SystemExit(INTERRUPTED)
        await starting
        links = describe_links(live.fleet)
        if truth:
            for controller in (controller for link in links for controller in link["controllers"]):
                controller["truth"] = str(folder / "truth" / f"{controller['name']}.jsonl")
        print_result({"state": str(folder), "links": links}, _describe(links, folder), as_json=as_json)
        live.say = print_line
        assert live.failed is not None
        await asyncio.wait([ended_task, live.failed], return_when=asyncio.FIRST_COMPLETED)
        await live.close()
        if live.failed.done():
            exit_with_error(live.failed.result(), FAILED, f"see {folder / 'log'}", code="not-started")

    run_main(run_simulators())


def _find_fleet(
    model: str | None, file: Path | None, number: int | None, options: str, kind: "LinkKind | None"
) -> "Fleet":
    """The controllers to serve; exits with the mistake of the arguments."""
    from orchestrator.runtime.checked import load_checked_fleet
    from orchestrator.runtime.live.served import make_served_fleet, replace_links

    if (model is None) == (file is None):
        raise click.UsageError("name a MODEL, or a file with --fleet", click.get_current_context())
    own = _parse_options(options)
    try:
        if file is not None:
            if number is not None or own:
                raise click.UsageError("--number and --options need a MODEL; the file states them")
            fleet = load_checked_fleet(file)
        else:
            fleet = make_served_fleet(cast(str, model), number or 1, own)
        return fleet if kind is None else replace_links(fleet, kind)
    except ValueError as error:
        exit_with_error(str(error), BAD_INPUT)


def _parse_options(text: str) -> dict[str, Any]:
    try:
        value: object = json.loads(text)
    except json.JSONDecodeError as error:
        raise click.BadParameter(f"not JSON: {error}", param_hint="--options") from None
    if not isinstance(value, dict):
        raise click.BadParameter('it must be a JSON object, e.g. {"axes": 2}', param_hint="--options")
    return cast(dict[str, Any], value)


def _describe(links: list[dict[str, Any]], folder: Path) -> str:
    from orchestrator.runtime.live.fleet import HAS_WORLDS

    lines: list[str] = []
    for link in links:
        for controller in link["controllers"]:
            address = "" if controller["address"] is None else f", address {controller['address']}"
            lines.append(f"{controller['name']}: {controller['model']} on {_describe_place(link)}{address}")
            if "truth" in controller:
                lines.append(f"  true motions: {controller['truth']}")
    if HAS_WORLDS:
        first = links[0]["controllers"][0]["name"]
        lines.append(f"to change their environment: tutti sim power {first} off --state {folder}")
    return "\n".join([*lines, "Ctrl-C ends it"])


def _describe_place(link: dict[str, Any]) -> str:
    match link["kind"]:
        case "serial":
            frame = f"{link['data_bits']}{link['parity'][0].upper()}{link['stop_bits']}"
            return f"{link['device']}, {link['baud']} baud {frame}"
        case "can":
            return f"{link['channel']} ({link['interface']}), {link['bitrate']} bit/s"
        case kind:
            return f"{kind} {link['host']}:{link['port']}"
