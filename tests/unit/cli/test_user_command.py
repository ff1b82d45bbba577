"""`tutti user`: users, roles, passwords and tokens, without a running fleet."""

import json
from pathlib import Path
from typing import Any

import pytest
from click.testing import CliRunner, Result

from orchestrator.cli.main import main

PASSWORD = "correct horse\n"


class Users:
    """The command on one state folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def run(self, *words: str, typed: str = "") -> Result:
        return CliRunner().invoke(main, ["user", *words, "--state", str(self.folder)], input=typed)

    def done(self, *words: str, typed: str = "") -> str:
        result = self.run(*words, typed=typed)
        assert result.exit_code == 0, result.output
        return result.output

    def list_all(self) -> list[dict[str, Any]]:
        return json.loads(self.done("ls", "--json"))


@pytest.fixture
def users(tmp_path: Path) -> Users:
    return Users(tmp_path / "state")


def test_a_user_is_added_listed_changed_and_removed(users: Users) -> None:
    assert "whatever reaches this machine" in users.done("ls")
    said = users.done("add", "anna", "--role", "operator", "--password-stdin", typed=PASSWORD)
    assert "everyone has to sign in" in said
    assert "everyone" not in users.done("add", "ci", "--role", "proposer", "--no-password")
    assert "operator" in users.done("ls") and "tokens only" in users.done("ls")
    users.done("passwd", "anna", "--password-stdin", typed="another password\n")
    users.done("role", "anna", "maintainer")
    assert [(each["name"], each["role"]) for each in users.list_all()] == [("anna", "maintainer"), ("ci", "proposer")]
    assert "no users any more" not in users.done("rm", "ci")
    assert "no users any more" in users.done("rm", "anna")


def test_a_token_is_printed_once_and_never_listed(users: Users) -> None:
    users.done("add", "ci", "--role", "proposer", "--no-password")
    words = ["token", "ci", "--name", "nightly", "--verb", "submit", "--expires", "30d", "--json"]
    made = json.loads(users.done(*words))
    assert made["token"].startswith("tutti_ci_") and len(made["token"]) > 50
    (listed,) = users.list_all()
    assert listed["tokens"]["nightly"]["verbs"] == ["submit"] and made["token"] not in json.dumps(listed)
    assert "digest" not in json.dumps(listed) and "password" not in listed
    users.done("token", "ci", "--remove", "nightly")
    assert not users.list_all()[0]["tokens"]


@pytest.mark.parametrize(
    ("words", "typed", "text"),
    [
        (("add", "An Na", "--role", "viewer", "--password-stdin"), PASSWORD, "is no name of a user"),
        (("add", "eve", "--role", "viewer", "--password-stdin"), "short\n", "has 8 to 1000 characters"),
        (("add", "eve", "--role", "god", "--no-password"), "", "'god' is not one of"),
        (("add", "eve", "--role", "viewer"), "", "no terminal to ask for a password"),
        (("add", "anna", "--role", "viewer", "--no-password"), "", "there is a user anna already"),
        (("rm", "eve"), "", "there is no user eve; there are: anna"),
        (("passwd", "eve", "--password-stdin"), PASSWORD, "there is no user eve"),
        (("role", "eve", "viewer"), "", "there is no user eve"),
        (("token", "eve"), "", "there is no user eve"),
        (("token", "anna", "--verb", "fly"), "", "no verb 'fly'"),
        (("token", "anna", "--remove", "none"), "", "has no token none"),
        (("token", "anna", "--expires", "soon"), "", "write a number and s, min, h, d or w"),
    ],
)
def test_what_is_wrong_is_said_with_exit_code_2(users: Users, words: tuple[str, ...], typed: str, text: str) -> None:
    users.done("add", "anna", "--role", "operator", "--no-password")
    result = users.run(*words, typed=typed)
    assert result.exit_code == 2, result.output
    assert text in result.output
    assert [each["name"] for each in users.list_all()] == ["anna"]


def test_a_damaged_file_is_named_and_kept(users: Users) -> None:
    users.done("add", "anna", "--role", "operator", "--no-password")
    file = users.folder / "users.json"
    file.write_text("{")
    result = users.run("ls")
    assert result.exit_code != 0 and "users.json" in result.output and "restore the file" in result.output
    assert users.run("add", "eve", "--role", "viewer", "--no-password").exit_code != 0
    assert file.read_text() == "{"
