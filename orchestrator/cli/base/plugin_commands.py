"""Commands that installed packages add to `tutti`, by entry points of the group `tutti.commands`.

An entry point is named as its command is called: `epics`, or `job from-useq` for a command of the group `job`. Its
module is imported when the command, or a list of commands, is asked for, so it imports little itself.
"""

from importlib.metadata import EntryPoint, entry_points

import click

from orchestrator.model.plugins import PluginError, package_of

GROUP = "tutti.commands"


def find_plugin_commands(*groups: str) -> dict[str, EntryPoint]:
    """The commands that packages add to a group, by name. groups: its words behind `tutti`; none: the root."""
    commands: dict[str, EntryPoint] = {}
    for entry in entry_points(group=GROUP):
        *words, name = entry.name.split()
        if tuple(words) == groups:
            commands[name] = entry
    return dict(sorted(commands.items()))


def load_plugin_command(entry: EntryPoint) -> click.Command:
    """The command of an entry point. Raises `PluginError` for a package that is broken."""
    try:
        command: click.Command = entry.load()
    except Exception as error:
        origin = f"the command `tutti {entry.name}` of package {package_of(entry)}"
        text = f"{origin} cannot be imported: {type(error).__name__}: {error}"
        raise PluginError(text, "repair or uninstall this package") from None
    return command


class PluginGroup(click.Group):
    """A group to which packages may add commands; they are looked for after its own."""

    plugin_words: tuple[str, ...] = ()
    """The words of the group behind `tutti`."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return list(dict.fromkeys([*super().list_commands(ctx), *find_plugin_commands(*self.plugin_words)]))

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        command = super().get_command(ctx, cmd_name)
        if command is None and (entry := find_plugin_commands(*self.plugin_words).get(cmd_name)) is not None:
            command = load_plugin_command(entry)
        return command
