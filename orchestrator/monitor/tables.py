"""Tables for a terminal: no frames, because at 80 columns every character is needed for text and figures."""

from collections.abc import Sequence

from rich.table import Table


def make_plain_table(columns: Sequence[str]) -> Table:
    """Return a table of these columns; those whose name ends in `>` are right-aligned. Rows are never wrapped."""
    table = Table(box=None, header_style="bold underline", pad_edge=False, padding=(0, 2, 0, 0))
    for name in columns:
        right = name.endswith(">")
        table.add_column(name.removesuffix(">"), justify="right" if right else "left", no_wrap=True)
    return table
