"""The root command: subcommands are imported when they are used, so that `tutti --help` is quick."""

import os
from importlib import import_module
from pathlib import Path

import click

from orchestrator.cli.base.plugin_commands import PluginGroup
from orchestrator.cli.base.root import RootGroup

# command: (module, one line of help); grouped as the help shows them.
_COMMANDS: dict[str, tuple[str, str]] = {
    "up": ("machine.up", "Start everything for a fleet on this machine."),
    "host": ("machine.host", "Run the adapter host of this computer for a fleet."),
    "down": ("machine.down", "End a fleet that runs on this machine."),
    "status": ("view.fleet", "Show every controller and axis."),
    "watch": ("view.watch.watch", "Watch the fleet and the running job live."),
    "stop": ("view.fleet", "Stop all axes by their ramps."),
    "estop": ("view.fleet", "Stop everything immediately, and latch."),
    "reset": ("view.fleet", "Release the e-stop latch and clear faults."),
    "submit": ("jobs.job", "Submit a job (same as `job submit`)."),
    "queue": ("jobs.queue", "Start, stop and show the queue of jobs."),
    "job": ("jobs.job", "Submit, list, show, cancel jobs; read reports."),
    "axis": ("manual.axis", "Manual operation: list, enable, home, jog, move."),
    "live": ("manual.live", "Move axes line by line, as one job."),
    "path": ("paths.path", "Paths: plot them before they run, import them."),
    "position": ("manual.positions", "Named positions: save, list, move to them."),
    "io": ("manual.io", "Inputs and outputs by name."),
    "fleet": ("files.fleet", "Check a fleet file; load it into the running fleet."),
    "zones": ("files.zones", "Keep-out zones: check what must not collide."),
    "alarm": ("view.alarms", "Alarms: list, acknowledge, shelve."),
    "stats": ("view.statistics", "Statistics of axes, controllers and jobs."),
    "wiring": ("machine.wiring", "Check the trigger wires between controllers."),
    "clock": ("machine.clock", "Show the estimates of the controllers' clocks."),
    "service": ("machine.service_files", "Run parts as services of systemd."),
    "doctor": ("machine.doctor", "Check this computer, and say what to do."),
    "journal": ("machine.journal", "The journal: check, back up, export, import."),
    "coordinator": ("machine.coordinator", "Run a coordinator by itself, or hand over to another."),
    "repair": ("machine.repair", "Repair what needs a person's decision: epochs."),
    "log": ("view.log", "Show the logs of all processes, by fleet time."),
    "command": ("view.commands", "Commands of users, as the journal has them."),
    "keys": ("keys.keys", "Keys of a fleet: its authority, certificates, roles."),
    "router": ("keys.router", "Run the fleet's router by itself, with TLS and roles."),
    "user": ("keys.users", "Users of the page: roles, passwords, tokens."),
    "raw": ("machine.controller", "Send a command in a controller's own language."),
    "trace": ("view.trace", "Show the last frames on a controller's link."),
    "record": ("records.record", "Recordings: list and repair them, record a fleet."),
    "export": ("records.export", "Write a recording as tables: Parquet, CSV, HDF5."),
    "completion": ("completion", "Print the completion script of a shell."),
    "schema": ("files.schema", "Print the JSON Schema of a fleet or job file."),
    "demo": ("demo", "Run a job on a simulated fleet and show the report."),
    "bench": ("bench", "Measure Tutti on this computer."),
    "sim": ("sim.sim", "Simulated controllers: check and manipulate them."),
    "adapter": ("machine.adapters", "Makes of others: write, check and list adapters."),
}


def _note_identity(_: click.Context, __: click.Parameter, value: Path | None) -> None:
    """Processes that the command starts have it by the environment."""
    if value is not None:
        os.environ["TUTTI_IDENTITY"] = str(value.absolute())


EPILOG = """\b
Exit codes: 0 done; 1 refused or failed by a running fleet; 2 bad input:
arguments, files, a name that the fleet does not have; 3 nothing answers: bus,
fleet, coordinator, controller; 130 interrupted. With --json an error is one
object on standard output: {"code", "text", "remedy"}.

\b
Examples:
tutti demo
tutti fleet init --make smc4000 --make smc30:3 -o lab.fleet.yaml
tutti up lab.fleet.yaml --sim
"""


class _LazyGroup(RootGroup):
    """Lists its commands by name and imports the one that is called."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(_COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if cmd_name not in _COMMANDS:
            return None
        command: click.Command = getattr(import_module(f"orchestrator.cli.{_COMMANDS[cmd_name][0]}"), cmd_name)
        return command


class _TuttiGroup(PluginGroup, _LazyGroup):
    """All commands of `tutti`."""

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        try:
            return super().resolve_command(ctx, args)
        except click.exceptions.NoSuchCommand as error:
            if error.ctx is not ctx:
                raise
            names = self.list_commands(ctx)
            raise click.exceptions.NoSuchCommand(error.command_name, possibilities=names, ctx=ctx) from None

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        with formatter.section("Commands"):
            formatter.write_dl([(name, text) for name, (_, text) in _COMMANDS.items()])
        added_names = [name for name in self.list_commands(ctx) if name not in _COMMANDS]
        commands = [(name, self.get_command(ctx, name)) for name in added_names]
        if commands:
            with formatter.section("Integrations"):
                rows = [(name, "" if command is None else command.get_short_help_str()) for name, command in commands]
                formatter.write_dl(rows)


@click.command(cls=_TuttiGroup, epilog=EPILOG, context_settings={"help_option_names": ["-h", "--help"]})
@click.version_option(package_name="tutti")
@click.option(
    "--identity",
    type=click.Path(path_type=Path, exists=True, file_okay=False),
    envvar="TUTTI_IDENTITY",
    show_envvar=True,
    expose_value=False,
    callback=_note_identity,
    help="Folder with the certificate for routers with TLS, as `tutti keys` makes it.",
)
def main() -> None:
    """Tutti makes motion controllers of different makers move as one machine."""
