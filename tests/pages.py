"""The code blocks of the documents."""

import re
import textwrap
from pathlib import Path

ECOSYSTEM_PAGES = ("how-to/serve-epics.md", "how-to/serve-ros2.md")
"""Pages whose blocks need clients of other projects: `tests/ecosystem/test_pages.py` runs them."""

OWN_PAGES = ("how-to/run-a-microscope-sequence.md", "how-to/serve-opcua.md", "how-to/use-bluesky.md")
"""Such pages that the test of their integration runs."""


def read_blocks(page: Path, *languages: str) -> list[str]:
    """The blocks of a page in one of these languages, without their indentation."""
    fenced = rf"^( *)```(?:{'|'.join(languages)})\n(.*?)^\1```"
    text = page.read_text(encoding="utf-8")
    return [textwrap.dedent(block) for _, block in re.findall(fenced, text, re.MULTILINE | re.DOTALL)]


def commands(page: Path) -> list[str]:
    """The lines of a page's `console` blocks that begin with a prompt, without it."""
    lines = [line for block in read_blocks(page, "console") for line in block.splitlines()]
    return [line.removeprefix("$ ") for line in lines if line.startswith("$ ")]


def programs(page: Path) -> list[str]:
    """The `python` blocks of a page that are whole programs, each as a command."""
    return [
        f"cd /tmp/; python - <<'PROGRAM'\n{block}PROGRAM\n"
        for block in read_blocks(page, "python")
        if block.startswith(("from ", "import "))
    ]
