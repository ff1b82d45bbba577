"""A group of commands one of which may be left out."""

from typing import Any

import click


class DefaultGroup(click.Group):
    """A group whose first word is the argument of its default command, unless it names another one.

    default: the name of that command."""

    def __init__(self, *args: Any, default: str, **attributes: Any) -> None:
        super().__init__(*args, **attributes)
        self._default = default

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        """Put the name of the default command in front, where none is given."""
        is_help = not args or args[0] in self.get_help_option_names(ctx)
        if not is_help and args[0] not in self.commands:
            args = [self._default, *args]
        return super().parse_args(ctx, args)
