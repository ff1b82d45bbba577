"""The commands that a wrong word may stand for, in any group: `tutti axis move` for `tutti move`."""

import difflib
from collections.abc import Iterator

import click

MAX_COMMANDS = 3
_NEAR = 0.75  # how alike two words are at least, of 1


def find_nearest_commands(root: click.Context, word: str) -> list[str]:
    """The whole commands whose last word is `word`; if there are none, those whose last word is most like it."""
    paths = list(_list_paths(root, root.command, root.command_path))
    same_paths = [path for path in paths if path.split()[-1] == word]
    if same_paths:
        return same_paths[:MAX_COMMANDS]
    last_words = dict.fromkeys(path.split()[-1] for path in paths)
    near_words = difflib.get_close_matches(word[:80], list(last_words), MAX_COMMANDS, _NEAR)
    return [path for near_word in near_words for path in paths if path.split()[-1] == near_word][:MAX_COMMANDS]


def _list_paths(context: click.Context, command: click.Command, path: str) -> Iterator[str]:
    """All commands below one, by their whole words; those of the upper groups first."""
    if not isinstance(command, click.Group):
        return
    commands = {name: command.get_command(context, name) for name in command.list_commands(context)}
    shown_commands = {name: inner for name, inner in commands.items() if inner is not None and not inner.hidden}
    yield from (f"{path} {name}" for name in shown_commands)
    for name, inner in shown_commands.items():
        yield from _list_paths(context, inner, f"{path} {name}")
