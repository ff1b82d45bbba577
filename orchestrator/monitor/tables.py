"""Tables for a terminal: no frames, because at 80 columns every character is needed for text and figures.

Where a terminal is too narrow for a table, its rows are stacked: a line for each cell that has a value.
"""

from collections.abc import Collection, Iterator, Sequence

from rich.console import Console, ConsoleOptions, RenderResult
from rich.measure import Measurement
from rich.padding import Padding
from rich.segment import Segment
from rich.table import Table
from rich.text import Text

MIN_SHRUNK = 12  # characters that a shrinking column keeps
NATURAL = 100_000  # columns: more than any table needs


class PlainTable(Table):
    """A table that is stacked where it does not fit.

    Notes stand below their row, over the whole width; a table with notes has no cell that wraps."""

    def __init__(self, columns: Sequence[str], shrinking: Collection[str]) -> None:
        super().__init__(box=None, header_style="bold underline", pad_edge=False, padding=(0, 2, 0, 0))
        self.shrinking = shrinking
        self.notes: dict[int, str] = {}
        for name in columns:
            title = name.removesuffix(">")
            self.add_column(title, justify="right" if title != name else "left", no_wrap=title not in shrinking)

    def add_note(self, text: str) -> None:
        """Add a note to the last row."""
        self.notes[self.row_count - 1] = text

    def __rich_console__(self, console: Console, options: ConsoleOptions) -> RenderResult:
        if self._find_least_width(console, options) > options.max_width:
            yield from self._stack_rows()
            return
        lines = Segment.split_lines(super().__rich_console__(console, options))  # pyright: ignore[reportArgumentType]
        # The first line is the header.
        for number, line in enumerate(lines, start=-1):
            yield from line
            yield Segment.line()
            if number in self.notes:
                yield Padding(Text(self.notes[number], "dim"), (0, 0, 0, 10), expand=False)

    def _find_least_width(self, console: Console, options: ConsoleOptions) -> int:
        """The width below which the table would lose more than the ends of long texts."""
        wide = options.update(max_width=NATURAL)
        least = super().__rich_measure__(console, wide).maximum
        for column in self.columns:
            if column.header in self.shrinking:
                cells = [Measurement.get(console, wide, cell).maximum for cell in (column.header, *column.cells)]
                least -= max(0, max(cells) - MIN_SHRUNK)
        return least

    def _stack_rows(self) -> Iterator[Table | Text]:
        rows = list(zip(*(column.cells for column in self.columns), strict=True))
        for number, cells in enumerate(rows):
            grid = Table.grid(padding=(0, 2, 0, 0))
            grid.add_column(no_wrap=True, style="dim")
            grid.add_column(overflow="fold")
            for column, cell in zip(self.columns, cells, strict=True):
                if str(cell):
                    grid.add_row(str(column.header), cell)
            if number in self.notes:
                grid.add_row("", Text(self.notes[number], "dim"))
            yield grid
            if number < len(rows) - 1:
                yield Text()


def make_plain_table(columns: Sequence[str], shrinking: Collection[str] = ()) -> PlainTable:
    """Return a table of these columns; those whose name ends in `>` are right-aligned.

    shrinking: columns of texts that wrap where the terminal is narrow, or are cut if they are not to wrap.
    """
    return PlainTable(columns, shrinking)
