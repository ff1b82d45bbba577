"""Messages of this and of earlier protocol versions are read, and none of their fields is lost or has another type."""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from cluster.test_bus_page import section
from compat.messages import GoldenName, find_model, find_verbs, name_key

from orchestrator.model.base import Model
from orchestrator.model.version import PROTOCOL

FOLDER = Path(__file__).parent
VERSIONS = sorted(
    (path.name for path in FOLDER.glob("[0-9]*.[0-9]*")), key=lambda each: [int(n) for n in each.split(".")]
)
# Keys of the page without a message in the virtual fleet, and why.
WITHOUT = {
    "lease.axis": "no make here lets axes of one controller move for different holders",
    "live": "presence has no payload",
    "log": "a line of a log has no model",
    "user": "published by programs of users",
    "alarm-request": "published by programs of users",
}


def find_losses(kept: Any, now: Any, place: str = "") -> list[str]:
    """The fields of a stored message that a model of today does not write again as they are."""
    if isinstance(kept, dict) and isinstance(now, dict):
        missing = [f"{place}.{name} is gone" for name in kept.keys() - now.keys()]
        common = sorted(kept.keys() & now.keys())
        return missing + [loss for name in common for loss in find_losses(kept[name], now[name], f"{place}.{name}")]
    if isinstance(kept, list) and isinstance(now, list) and len(kept) == len(now):
        pairs = enumerate(zip(kept, now, strict=True))
        return [loss for number, (old, new) in pairs for loss in find_losses(old, new, f"{place}[{number}]")]
    same = type(kept) is type(now) and kept == now
    return [] if same else [f"{place} was {json.dumps(kept)[:60]}, and is {json.dumps(now)[:60]}"]


def read_again(model: type[Model], part: str, text: str) -> Any:
    """What a model of today makes of a stored message; a request is read strictly."""
    read = model.model_validate_json if part == "request" else model.read_message
    return json.loads(read(text).to_json())


@pytest.fixture(scope="module")
def verbs() -> dict[str, tuple[type[Model], type[Model]]]:
    return find_verbs()


@pytest.mark.parametrize("version", VERSIONS)
def test_stored_messages_are_read_and_keep_their_fields(
    version: str, verbs: dict[str, tuple[type[Model], type[Model]]]
) -> None:
    losses: list[str] = []
    without: list[str] = []
    files = sorted((FOLDER / version).glob("*.json"))
    assert files and (version != "1.5" or len(files) > 100)
    for path in files:
        key, part, _ = path.name.rsplit(".", 2)
        text = path.read_text(encoding="utf-8")
        model = find_model(GoldenName(key, part), verbs)
        if model is None:
            without.append(path.name)
        else:
            losses += [f"{path.name}{loss}" for loss in find_losses(json.loads(text), read_again(model, part, text))]
    assert not losses, losses[:10]
    assert without == []


def test_every_key_of_the_page_has_a_message() -> None:
    """A version has the messages that it has added or changed."""
    assert str(PROTOCOL) in VERSIONS
    names = {path.name.rsplit(".", 2)[0] for version in VERSIONS for path in (FOLDER / version).glob("*.json")}
    page = {
        key for title in ("To watch", "To act") for keys, _ in section(title) for key in re.findall(r"`([^`]+)`", keys)
    }
    wanted = {name_key(f"tutti/v1/f/{re.sub(r'[{}]', '', key)}") for key in page}
    assert {each for each in wanted - names if each.partition(".")[0] not in WITHOUT and each not in WITHOUT} == set()


def test_a_field_that_is_gone_or_of_another_type_is_found() -> None:
    kept = {"a": 1, "b": [{"c": "x"}], "d": None}
    assert find_losses(kept, {**kept, "added": 2}) == []
    assert find_losses(kept, {"a": 1, "b": [{"c": "x"}]}) == [".d is gone"]
    assert find_losses(kept, {**kept, "a": 1.0}) == [".a was 1, and is 1.0"]
    assert find_losses(kept, {**kept, "b": [{"e": "x"}]}) == [".b[0].c is gone"]
