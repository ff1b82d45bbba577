"""Write the page of versions that integrations were tested with; `make test-ecosystem-nightly` runs it.

The page says what is installed where the tests have just passed. `--check` says whether the page is that of the lock.
"""

import re
import sys
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

ROOT = Path(__file__).parents[1]
PAGE = ROOT / "docs/reference/integrations.md"
LOCK = ROOT / "requirements/ecosystem.lock"

ROWS = (
    ("Bluesky", "use-bluesky", "bluesky", ("bluesky", "ophyd-async", "event-model", "scanspec", "bluesky-queueserver")),
    ("EPICS", "serve-epics", "epics", ("p4p", "caproto", "aioca", "ophyd-async")),
    ("OPC UA", "serve-opcua", "opcua", ("asyncua",)),
    ("ROS 2", "serve-ros2", "ros2", ("rosbags", "zenoh-ros2-sdk", "eclipse-zenoh")),
    ("useq-schema", "run-a-microscope-sequence", "useq", ("useq-schema",)),
    ("MQTT", "publish-by-mqtt", "mqtt", ("aiomqtt", "paho-mqtt")),
)
"""Title, how-to page, extra, and the packages whose versions matter."""


def read_lock() -> dict[str, str]:
    """Versions in the lock of the environment, by package."""
    text = LOCK.read_text(encoding="utf-8")
    return dict(re.findall(r"^([a-z0-9][a-z0-9._-]*)==([^ \\]+)", text, re.MULTILINE))


def make_page(versions: dict[str, str]) -> str:
    """The page."""
    lines = [
        "# Integrations and versions",
        "",
        "Written by `tools/integration_matrix.py`. Clients that are not Tutti's own drive the unchanged demo fleet in",
        "`make test-ecosystem`, with these versions:",
        "",
        "| integration | extra | tested with |",
        "|---|---|---|",
    ]
    for title, page, extra, packages in ROWS:
        words = ", ".join(f"{name} {versions.get(name, 'not installed')}" for name in packages)
        lines.append(f"| [{title}](../how-to/{page}.md) | `tutti[{extra}]` | {words} |")
    return "\n".join(lines) + "\n"


def find_installed() -> dict[str, str]:
    """Versions of this environment."""
    versions: dict[str, str] = {}
    for name in {name for *_, packages in ROWS for name in packages}:
        try:
            versions[name] = version(name)
        except PackageNotFoundError:
            continue
    return versions


def main() -> None:
    if "--check" in sys.argv[1:]:
        if PAGE.read_text(encoding="utf-8") != make_page(read_lock()):
            sys.exit(f"{PAGE} is not that of {LOCK.name}: run `make test-ecosystem-nightly`, or this file there")
        return
    PAGE.write_text(make_page(find_installed()), encoding="utf-8")


if __name__ == "__main__":
    main()
