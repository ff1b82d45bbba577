"""The command blocks of the pages about several computers, keys, services and upgrades, run on two computers: each is a
network namespace with a home of its own.

A prompt names the computer. Differences to what the pages say: controllers are simulated, and `scp` copies folders.
"""

import json
import os
import re
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import pytest
from children import LIMIT_S
from fleet import EXAMPLES
from pages import read_blocks
from parts import Part
from test_namespaces import FIRST, SECOND, computers, pytestmark

from orchestrator.model.jobs.files import load_fleet

__all__ = ["computers", "pytestmark"]  # network namespaces, and root for them

PAGES = ("use-several-computers.md", "manage-keys.md", "run-as-a-service.md", "upgrade.md")
FIELDS = {"use-several-computers.md": {"routers": ["tls/pc-a:7447"]}}
"""What the page adds to the fleet file."""
BEFORE = {"upgrade.md": ["pc-a$ tutti up lab.fleet.yaml"]}
"""What is there before: the fleet that is upgraded."""
HOW_TO = Path(__file__).parents[2] / "docs" / "how-to"
ADDRESSES = {"pc-a": FIRST, "pc-b": SECOND}
READY = {"router": "router on", "up": "is up", "host": "drives"}
"""Commands that run until they are ended, and what they print when they are ready."""
STAYS = re.compile(rf"tutti (?:--identity \S+ )?({'|'.join(READY)}) ")


def list_commands(page: str) -> list[str]:
    """The lines of a page's `console` blocks with a prompt."""
    lines = [line for block in read_blocks(HOW_TO / page, "console") for line in block.splitlines()]
    return [line for line in lines if re.match(r"pc-[ab]\$ ", line)]


class Laboratory:
    """Two computers, and what runs on them. folders: the home of each; namespaces: the network of each."""

    def __init__(self, folder: Path, namespaces: tuple[str, str]) -> None:
        self._namespaces = dict(zip(ADDRESSES, namespaces, strict=True))
        self._folders = {name: folder / name for name in ADDRESSES}
        self._exported: dict[str, list[str]] = {name: [] for name in ADDRESSES}
        self._stay: dict[tuple[str, str], Part] = {}
        self._said = folder / "said"
        self._tools = folder / "tools"
        for each in (*self._folders.values(), self._said, self._tools):
            each.mkdir()
        # `scp FILE … COMPUTER:`
        copy = f'#!/bin/sh\nfor last; do :; done\nfor each; do [ "$each" = "$last" ] || cp -r "$each" {folder}/${{last%:}}; done\n'
        (self._tools / "scp").write_text(copy)
        (self._tools / "scp").chmod(0o755)
        self._name_computers()

    def _name_computers(self) -> None:
        lines = ["127.0.0.1 localhost", *(f"{address} {name}" for name, address in ADDRESSES.items())]
        for namespace in self._namespaces.values():
            place = Path("/etc/netns") / namespace
            place.mkdir(parents=True)
            (place / "hosts").write_text("\n".join(lines) + "\n")

    def write_fleet(self, fields: Mapping[str, Any]) -> None:
        """Write the fleet file of the pages, with more fields."""
        plain: dict[str, Any] = {**load_fleet(EXAMPLES / "demo.fleet.yaml").to_plain(), "fleet": "lab", **fields}
        for name, host in (("gantry", "a"), ("stage", "b")):
            plain["controllers"][name]["host"] = host
        (self._folders["pc-a"] / "lab.fleet.yaml").write_text(json.dumps(plain))

    def act(self, line: str) -> None:
        """Do what a line of a page says; a command that stays takes the place of one of its kind."""
        computer, _, command = line.partition("$ ")
        if command.startswith("export "):
            self._exported[computer].append(command)
            return
        stays = STAYS.search(command)
        if stays is None:
            part = self._start(computer, command)
            try:
                part.process.wait(3 * LIMIT_S)
            finally:
                part.end()
            said = part.said.read_text()
            # What a doctor finds on this computer is no fault of the page.
            assert part.process.returncode == 0 or (" doctor" in command and "Traceback" not in said), said
            return
        kind = stays[1]
        if (former := self._stay.pop((computer, kind), None)) is not None:
            former.end()
        bare, mark, comment = command.partition("  #")
        simulated = f"{bare} --sim{mark}{comment}" if kind != "router" else command
        self._stay[computer, kind] = part = self._start(computer, simulated)
        part.wait_for(READY[kind])

    def _start(self, computer: str, command: str) -> Part:
        home = self._folders[computer]
        path = f"{self._tools}:{Path(sys.executable).parent}:{os.environ['PATH']}"
        settings = [f"cd {home}", f"export HOME={home} XDG_STATE_HOME={home}/state PATH={path}", "unset TUTTI_STATE"]
        stays = "exec " if STAYS.search(command) else ""
        script = "\n".join([*settings, *self._exported[computer], f"{stays}{command}"])
        return Part(self._said, self._namespaces[computer], None, "bash", "-euc", script)

    def close(self) -> None:
        for part in reversed(self._stay.values()):
            part.end()
        for namespace in self._namespaces.values():
            place = Path("/etc/netns") / namespace
            (place / "hosts").unlink(missing_ok=True)
            place.rmdir()


@pytest.fixture
def laboratory(tmp_path: Path, computers: tuple[str, str]) -> Iterator[Laboratory]:
    made = Laboratory(tmp_path, computers)
    try:
        yield made
    finally:
        made.close()


def test_every_page_with_commands_of_computers_is_run() -> None:
    assert {page.name for page in HOW_TO.glob("*.md") if list_commands(page.name)} == set(PAGES)


@pytest.mark.timeout(300)
@pytest.mark.parametrize("page", PAGES)
def test_the_commands_of_a_page_work_on_two_computers(laboratory: Laboratory, page: str) -> None:
    laboratory.write_fleet(FIELDS.get(page, {}))
    lines = list_commands(page)
    assert len(lines) > 2
    for line in [*BEFORE.get(page, []), *lines]:
        laboratory.act(line)
