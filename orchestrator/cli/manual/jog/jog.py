"""`tutti axis jog`: the jog panel on this terminal, connected to the bus."""

import asyncio
import sys
from typing import TYPE_CHECKING

import click

from orchestrator.cli.base.codes import BAD_INPUT, INTERRUPTED
from orchestrator.cli.base.common import fleet_options, with_fleet
from orchestrator.cli.base.completion import complete_axes
from orchestrator.cli.base.errors import exit_with_error
from orchestrator.cli.base.systems import require_unix
from orchestrator.clock.signals import TERMINAL_SIGNALS, call_at_signals

if TYPE_CHECKING:
    from orchestrator.client import Tutti
    from orchestrator.model.fleet import Axis


@click.command(
    epilog="""\b
Examples:
  tutti axis jog
  tutti axis jog gantry.x gantry.y

\b
Letting go: a terminal with the kitty keyboard protocol (kitty, foot, WezTerm,
Ghostty, recent Konsole and iTerm2; not inside tmux) reports it, and the axis
slows down at once. Any other terminal only repeats a held key: a first press
is a tap (0.2 s of motion), holding goes on when the repeats come, and the axis
slows down at most 0.12 s after you let go (0.2 s after a tap began).

\b
Whatever happens to this terminal, its connection or this process: an axis
moves at most 0.2 s longer than requests arrive, then slows down by itself."""
)
@click.argument("axes", nargs=-1, shell_complete=complete_axes)
@fleet_options
def jog(axes: tuple[str, ...], connect: str, fleet: str | None) -> None:
    """Jog AXES (axes or controllers; without: all) by the arrow keys, on a panel that shows their positions.

    ←/→ jog the chosen axis in its negative/positive direction while held, or by steps of 0.01 to 10 units (Tab), ↑/↓
    choose the axis, + - 1…9 the speed; e enables, h twice homes, z twice sets the position to 0. Space and Esc stop, s
    stops the whole fleet, x is an e-stop, q or Ctrl-C exits. A jogged axis is leased until 3 s after it has come to
    rest: meanwhile jobs that need it wait, and other users are refused.
    """
    require_unix("the jog panel", "jog on the operators' page, or move by `tutti axis move --relative AXIS=DISTANCE`")
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        exit_with_error(
            "the jog panel needs a terminal on standard input and output",
            BAD_INPUT,
            "to move axes from a script: `tutti axis move --relative AXIS=DISTANCE`",
        )

    async def run_jog(tutti: "Tutti") -> int:
        return await _run_panel(tutti, axes)

    code = with_fleet(connect, fleet, run_jog)
    if code:
        raise SystemExit(code)


async def _run_panel(tutti: "Tutti", wanted: tuple[str, ...]) -> int:
    """Run the panel; return its exit code."""
    from orchestrator.cli.manual.jog.panel import JogPanel
    from orchestrator.cli.manual.jog.session import JogSession
    from orchestrator.cli.manual.jog.terminal import RawTerminal

    axes = await _find_configurations(tutti, wanted)
    end: asyncio.Future[int] = asyncio.get_running_loop().create_future()

    def end_panel() -> None:
        if not end.done():
            end.set_result(INTERRUPTED)

    # From here on every exit passes the end of the context below, which restores the terminal.
    call_at_signals(end_panel, (*TERMINAL_SIGNALS, "SIGQUIT"))
    with RawTerminal(sys.stdin.fileno(), sys.stdout.fileno()) as terminal:
        panel = JogPanel(axes, terminal.releases, tutti.keys.fleet)
        async with JogSession(tutti, panel, terminal, end):
            return await end


async def _find_configurations(tutti: "Tutti", wanted: tuple[str, ...]) -> "dict[str, Axis]":
    """Return the configurations of the wanted axes, in order; an unknown name ends with exit code 2."""
    from orchestrator.model.fleet import Axis

    infos = await asyncio.gather(*(tutti.controller_info(controller) for controller in await tutti.status()))
    known_infos = {
        f"{info.controller}.{name}": Axis.model_validate(axis) for info in infos for name, axis in info.axes.items()
    }
    if not wanted:
        return known_infos
    chosen_axes: dict[str, Axis] = {}
    for name in wanted:
        configs = {axis: config for axis, config in known_infos.items() if name in (axis, axis.partition(".")[0])}
        if not configs and name.partition(".")[0] in await tutti.virtual_states():
            exit_with_error(
                f"{name} is virtual, and this panel jogs real axes",
                BAD_INPUT,
                "jog it on the operators' page, or from Python by `Tutti.manual_control`",
            )
        if not configs:
            exit_with_error(f"no axis or controller {name!r}; the axes are: {', '.join(known_infos)}", BAD_INPUT)
        chosen_axes |= configs
    return chosen_axes
