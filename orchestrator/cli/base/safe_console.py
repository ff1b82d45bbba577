"""A console on which text from outside is shown, and never obeyed by the terminal."""

from collections.abc import Iterable

from rich.console import Console, ConsoleOptions, RenderableType
from rich.segment import Segment

from orchestrator.model.text.outside_text import has_hidden, show_text


class SafeConsole(Console):
    """Escapes control characters of what is printed. The styles and movements of the console itself are no text."""

    def render(self, renderable: RenderableType, options: ConsoleOptions | None = None) -> Iterable[Segment]:
        for segment in super().render(renderable, options):
            if segment.control is None and has_hidden(segment.text.replace("\n", "")):
                text = "\n".join(map(show_text, segment.text.split("\n")))
                yield Segment(text, segment.style)
            else:
                yield segment
