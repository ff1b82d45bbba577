"""What refusals, causes and alarms say on the operators' page: names of what is there, never a command line."""

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]
TABLE: list[tuple[str, str]] = sorted(
    json.loads((ROOT / "orchestrator/gateway/page/src/remedies.json").read_text(encoding="utf-8")),
    key=lambda forms: -len(forms[0]),
)
# Texts of these are printed where the process runs, or by the command itself.
ELSEWHERE = (
    *(
        "orchestrator/bench/",
        "orchestrator/bus/",
        "orchestrator/campaign/",
        "orchestrator/cli/",
        "orchestrator/conformance/",
    ),
    *("orchestrator/keys/", "orchestrator/monitor/", "orchestrator/runtime/", "orchestrator/testing/"),
    *("orchestrator/gateway/certificate.py", "orchestrator/gateway/reach.py", "orchestrator/gateway/openapi.py"),
    *("orchestrator/gateway/access/users.py", "orchestrator/gateway/page"),
)
ALARMS = ("orchestrator/bus/zenoh/own_alarms.py",)  # of the bus, and shown on the page all the same


def list_sources() -> list[Path]:
    sources = [path for package in ("orchestrator", "adapters") for path in sorted((ROOT / package).rglob("*.py"))]
    names = [(path, path.relative_to(ROOT).as_posix()) for path in sources]
    return [path for path, name in names if name in ALARMS or not name.startswith(ELSEWHERE)]


def find_texts(path: Path) -> Iterator[tuple[int, str]]:
    """All texts of a source with their lines, without documentation; a value in one is `x`."""
    tree = ast.parse(path.read_text(encoding="utf-8"))
    skipped = {id(node.value) for node in ast.walk(tree) if isinstance(node, ast.Expr)}
    skipped |= {id(part) for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values}
    skipped |= {  # descriptions of fields: they are in the reference
        id(keyword.value)
        for node in ast.walk(tree)
        if isinstance(node, ast.Call)
        for keyword in node.keywords
        if keyword.arg == "description"
    }
    for node in ast.walk(tree):
        if id(node) in skipped:
            continue
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value
        elif isinstance(node, ast.JoinedStr):
            parts = [part.value if isinstance(part, ast.Constant) else "x" for part in node.values]
            yield node.lineno, "".join(map(str, parts))


def make_pattern(terminal: str) -> re.Pattern[str]:
    """As in `onPage` of the page."""
    return re.compile(re.escape(terminal).replace(r"\*", "[^`]*"))


def write_for_page(text: str) -> str:
    for terminal, page in TABLE:
        text = make_pattern(terminal).sub(page, text)
    return text


TEXTS = [
    (f"{path.relative_to(ROOT)}:{line}", text)
    for path in list_sources()
    for line, text in find_texts(path)
    if "`tutti " in text or "`--" in text
]


def test_the_walk_finds_refusals_causes_and_alarms() -> None:
    places = {place.rpartition(":")[0] for place, _ in TEXTS}
    for path in (
        *("orchestrator/coordinator/jobs/queue/conditions.py", "orchestrator/coordinator/alarms/fleet_sources.py"),
        *("orchestrator/client/connection.py", "adapters/ppsmc/polling.py", "orchestrator/bus/zenoh/own_alarms.py"),
    ):
        assert path in places
    assert len(TEXTS) > 80


@pytest.mark.parametrize("text", sorted({text for _, text in TEXTS}))
def test_a_remedy_names_what_is_on_the_page(text: str) -> None:
    shown = write_for_page(text)
    assert "`tutti " not in shown, f"add both forms to remedies.json: {shown}"
    assert not re.search(r"(?<![\w-])--[a-z]", shown), f"an option is no thing of the page: {shown}"
    assert "  " not in shown and not shown.endswith((":", "; ", ", ")), shown


def test_every_line_of_the_table_is_of_some_text() -> None:
    """What no text says any more is taken out; what another line takes first, too."""
    used = set[str]()
    for _, text in TEXTS:
        for terminal, page in TABLE:
            if make_pattern(terminal).search(text):
                used.add(terminal)
                text = make_pattern(terminal).sub(page, text)
    # Of the terminal's views, which older reports and hints of programs name.
    commands = "watch, estop, record, queue, clock, job report, job show, axis release, axis move, axis enable"
    kept = {f"`tutti {command}*`" for command in commands.split(", ")}
    assert [terminal for terminal, _ in TABLE if terminal not in used | kept] == []
