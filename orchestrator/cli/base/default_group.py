"""A group of commands one of which may be left out."""

from typing import Any

import click


class DefaultGroup(click.Group):
    """A group whose first word is the argument of its default command, unless it names another one.

    default: the name of that command."""

    def __init__(self, *args: Any, default: str, **attributes: Any) -> None:
        settings = {"ignore_unknown_options": True, **attributes.pop("context_settings", {})}
        super().__init__(*args, context_settings=settings, **attributes)
        self._default = default

    def resolve_command(
        self, ctx: click.Context, args: list[str]
    ) -> tuple[str | None, click.Command | None, list[str]]:
        """The command that the words name; the default one with all of them, where they name none."""
        if args and args[0] not in self.commands:
            args = [self._default, *args]
        return super().resolve_command(ctx, args)
