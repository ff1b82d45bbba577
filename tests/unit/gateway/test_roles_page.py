"""The table of roles in the how-to page states what the gateway enforces."""

import re
from pathlib import Path

import pytest

from orchestrator.gateway.access.roles import LEAST_ROLES, ROLES, Role, may

PAGE = Path(__file__).parents[3] / "docs" / "how-to" / "manage-users-and-roles.md"


def read_table() -> dict[str, list[str]]:
    """By verb, what the table has in the columns of the roles."""
    lines = PAGE.read_text(encoding="utf-8").splitlines()
    head = next(number for number, line in enumerate(lines) if line.startswith("| what | verbs |"))
    assert lines[head] == f"| what | verbs | {' | '.join(ROLES)} |"
    found: dict[str, list[str]] = {}
    for line in lines[head + 2 :]:
        if not line.startswith("|"):
            break
        cells = [cell.strip() for cell in line.strip("|").split("|")]
        for verb in re.findall(r"`([a-z-]+)`", cells[1]):
            assert verb not in found, verb
            found[verb] = cells[2:]
    return found


def test_the_table_has_every_verb() -> None:
    assert read_table().keys() == LEAST_ROLES.keys()


@pytest.mark.parametrize("role", ROLES)
def test_a_column_has_the_rights_of_its_role(role: Role) -> None:
    column = ROLES.index(role)
    stated = {verb: cells[column] == "yes" for verb, cells in read_table().items()}
    assert stated == {verb: may(role, verb) for verb in LEAST_ROLES}
