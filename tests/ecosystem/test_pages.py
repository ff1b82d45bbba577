"""The blocks of the pages about clients of other projects, run unchanged against the demo fleet."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from ecosystem.epics_server import free_ports
from pages import ECOSYSTEM_PAGES, commands, programs

from tutti.testing import LiveTestbed

pytestmark = pytest.mark.nightly
ROOT = Path(__file__).parents[2]


@pytest.mark.parametrize("page", ECOSYSTEM_PAGES)
def test_the_blocks_of_a_page_work(demo_fleet: LiveTestbed, tmp_path: Path, page: str) -> None:
    tutti = tmp_path / "tutti"
    tutti.write_text(f"#!{sys.executable}\nfrom orchestrator.cli.entry import main\nmain()\n")
    tutti.chmod(0o755)
    path = ROOT / "docs" / page
    *words, last = commands(path)  # the last one ends what the first one has begun
    script = "\n".join(["set -eu", *words, *programs(path), last])
    script = re.sub(r"/tmp\b", str(tmp_path), script)
    for port, free_port in zip(("5075", "5064"), free_ports(2), strict=True):
        script = re.sub(rf":{port}\b", f":{free_port}", script)
        option = {"5075": "--pva-port", "5064": "--ca-port"}[port]
        script = script.replace("tutti epics serve", f"tutti epics serve {option} {free_port}")
    script = script.replace("tcp/127.0.0.1:7447", demo_fleet.endpoint)
    environment = os.environ | {
        "PATH": f"{tmp_path}{os.pathsep}{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": str(ROOT),
        "TUTTI_CONNECT": demo_fleet.endpoint,
    }
    limited = ["timeout", "90", "bash", "-x", "-c", script]
    done = subprocess.run(limited, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout[-3000:] + done.stderr[-3000:]
