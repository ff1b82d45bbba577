"""`tutti adapter probe` on a real socket."""

import json

import pytest
from children import Children
from click.testing import CliRunner

from orchestrator.cli.main import main

pytestmark = pytest.mark.live


def test_a_reply_is_shown_with_its_time(children: Children) -> None:
    _, place = children.simulator("ascii", "tcp:127.0.0.1:0")
    endpoint = f"tcp:{place['host']}:{place['port']}"
    found = CliRunner().invoke(main, ["adapter", "probe", endpoint, "?", "--end", "", "--wait", "2", "--json"])
    assert found.exit_code == 0, found.output
    shown = json.loads(found.output)
    assert shown["sent"] == "?"
    assert "".join(each["data"] for each in shown["received"]).startswith("<Idle|MPos:0.000,0.000,0.000")
    assert 0 < shown["received"][0]["after_ns"] < 2_000_000_000
