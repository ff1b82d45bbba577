"""`tutti completion`: the script that makes a shell complete commands, options and the names of the running fleet."""

import click
from click.shell_completion import get_completion_class


@click.command(
    epilog="""\b
Examples:
  eval "$(tutti completion bash)"                      in ~/.bashrc
  eval "$(tutti completion zsh)"                       in ~/.zshrc
  tutti completion fish > ~/.config/fish/completions/tutti.fish"""
)
@click.argument("shell", type=click.Choice(["bash", "zsh", "fish"]))
def completion(shell: str) -> None:
    """Print the completion script of SHELL.

    Completed are commands, options, files, and names of the running fleet: axes, groups, controllers, inputs, outputs,
    jobs, fleets. Where no fleet answers within half a second, no names are offered.
    """
    kind = get_completion_class(shell)
    assert kind is not None
    root = click.get_current_context().find_root().command
    click.echo(kind(root, {}, "tutti", "_TUTTI_COMPLETE").source())
