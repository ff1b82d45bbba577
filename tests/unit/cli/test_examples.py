"""Every command line of the help texts and of the documents is one that `tutti` understands: command, options, and
choices of options. Nothing is run."""

import re
import shlex
from collections.abc import Iterator
from pathlib import Path

import click
import pytest
from pages import read_blocks
from unit.cli.test_command_rule import leaves

from orchestrator.cli.main import main

ROOT = Path(__file__).parents[3]
PAGES = [ROOT / "README.md", *(ROOT / "docs" / "how-to").glob("*.md"), *(ROOT / "docs" / "tutorial").glob("*.md")]
BEGINS = re.compile(r"^(?:(?:pc-\w)?\$ )?(?:sudo )?tutti ")
ENDS = ("|", "&&", "||", ";", ">", "2>", "<", "&", "#")


def join_lines(text: str) -> list[str]:
    """The lines of a text, those that continue as one."""
    return [line.strip() for line in re.sub(r"\\\n\s*", " ", text).splitlines()]


def find_lines() -> Iterator[tuple[str, str]]:
    """Where each command line is, and its words after `tutti`."""
    for name, command in leaves():
        for line in join_lines(command.epilog or ""):
            line = line.removeprefix("Example: ")
            if BEGINS.match(line):
                yield f"tutti {name} --help", line
    for page in PAGES:
        for block in read_blocks(page, "console", "sh"):
            for line in join_lines(block):
                if BEGINS.match(line):
                    yield str(page.relative_to(ROOT)), line


def parse_line(words: list[str]) -> None:
    """Parse as the command does, without running anything. Raises `click.UsageError`."""
    command: click.Command = main
    context = click.Context(command, info_name="tutti")
    while True:
        values, words, _ = command.make_parser(context).parse_args(words)
        for option in command.params:
            given = values.get(option.name or "")
            if isinstance(option, click.Option) and isinstance(option.type, click.Choice) and given is not None:
                for each in given if option.multiple else [given]:
                    option.type.convert(each, option, context)
        if not isinstance(command, click.Group):
            return
        assert words, "a group alone"
        name, found, words = command.resolve_command(context, words)
        assert name is not None and found is not None
        command, context = found, click.Context(found, info_name=name, parent=context)


def find_words(line: str) -> list[str]:
    words = shlex.split(BEGINS.sub("", line), comments=True)
    ends = [number for number, word in enumerate(words) if word in ENDS]
    return words[: ends[0]] if ends else words


LINES = sorted(set(find_lines()))


def test_there_are_many() -> None:
    assert len(LINES) > 200 and len({place for place, _ in LINES}) > 100


@pytest.mark.parametrize("place", sorted({place for place, _ in LINES}))
def test_every_command_line_is_one_that_is_understood(place: str) -> None:
    for line in [line for where, line in LINES if where == place]:
        try:
            parse_line(find_words(line))
        except (click.UsageError, ValueError) as error:
            pytest.fail(f"{place}: {line}\n{error}")


def test_a_wrong_line_is_noticed() -> None:
    for line in ("tutti host b --identity x", "tutti statis", "tutti export x --to nothing"):
        with pytest.raises(click.UsageError):
            parse_line(find_words(line))
