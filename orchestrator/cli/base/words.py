"""Words of a person at the terminal for something that moves: they count only after it was shown."""

import sys
import termios

import click


def forget_typed_ahead() -> None:
    """Drop what was typed before something was shown; nothing, if the input is no terminal."""
    if sys.stdin.isatty():
        termios.tcflush(sys.stdin, termios.TCIFLUSH)


def confirm_shown(question: str) -> bool:
    """Ask about what has just been shown."""
    forget_typed_ahead()
    return click.confirm(question)
