"""The code blocks of the documents."""

import re
import textwrap
from pathlib import Path


def read_blocks(page: Path, *languages: str) -> list[str]:
    """The blocks of a page in one of these languages, without their indentation."""
    fenced = rf"^( *)```(?:{'|'.join(languages)})\n(.*?)^\1```"
    text = page.read_text(encoding="utf-8")
    return [textwrap.dedent(block) for _, block in re.findall(fenced, text, re.MULTILINE | re.DOTALL)]
