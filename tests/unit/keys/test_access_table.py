"""The access table: what its rows include, by the router's rule that a message's key must be included in a row."""

from pathlib import Path

import pytest

from orchestrator.bus.keys import ANY_ESTOP, FleetKeys
from orchestrator.keys.access_table import Rights, find_rights
from orchestrator.keys.names import ROLES, KeyName, Role
from orchestrator.keys.register import Register
from orchestrator.keys.router_settings import make_access_settings, nest_settings
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import load_fleet

EXAMPLES = Path(__file__).parents[3] / "deploy" / "examples"
KEYS = FleetKeys("lab")
HOSTS = {"left": ["gantry"], "right": ["stage"]}


def rights_of(role: Role, name: str = "left") -> Rights:
    return find_rights(KeyName(role, name, 1), "lab", HOSTS)


def test_no_role_may_use_a_wildcard_over_the_whole_bus() -> None:
    for role in ROLES:
        rows = rights_of(role)
        for kind in ("puts", "serves", "queries", "tokens", "watches"):
            assert not [each for each in getattr(rows, kind) if each.startswith(f"{KEYS.prefix}/*")], (role, kind)
        assert "tutti/**" not in rows.subscribes


def test_a_host_has_its_own_controllers_only() -> None:
    rows = rights_of("host")
    assert KEYS.state("gantry") in rows.puts
    assert KEYS.served_of_controller("gantry") in rows.serves and KEYS.host_states("left") in rows.puts
    assert not {KEYS.served_of_controller(), KEYS.host_states(), KEYS.host_states("right")} & {*rows.puts, *rows.serves}
    assert not [each for kind in (rows.puts, rows.serves, rows.tokens) for each in kind if "stage" in each]
    # A certificate for a host that the fleet file does not have controls nothing.
    assert not [each for each in rights_of("host", "attic").puts if "/ctl/" in each]


@pytest.mark.parametrize("role", [role for role in ROLES if role != "coordinator"])
def test_the_coordinators_keys_are_its_own(role: Role) -> None:
    rows = rights_of(role)
    own = {KEYS.leader, KEYS.queue, KEYS.leases, KEYS.service(), KEYS.time, KEYS.leader_answer(), KEYS.job_state()}
    assert not own & {*rows.puts, *rows.serves}
    assert not {KEYS.command(), KEYS.batch_command()} & {*rows.queries}


def test_those_may_stop_everything_that_the_table_names() -> None:
    stopping = [role for role in ROLES if ANY_ESTOP in rights_of(role).puts]
    assert stopping == ["estop-button", "gateway", "maintainer", "operator"]
    assert rights_of("viewer").puts == ()


def test_raw_commands_need_a_maintainer() -> None:
    raw = KEYS.command(None, "raw")
    assert [role for role in ROLES if raw in rights_of(role).queries] == ["maintainer"]


def make_fleet(name: str = "lab") -> Fleet:
    return load_fleet(EXAMPLES / "demo.fleet.yaml").model_copy(update={"fleet": name})


def test_the_configuration_names_each_admitted_name_once_and_denies_the_rest() -> None:
    register = Register(fleet="lab", authority="")
    for name in (KeyName("host", "left", 3), KeyName("viewer", "anna", 1), KeyName("viewer", "ben", 1)):
        register = register.admit(name, "2027-01-01T00:00:00Z")
    access = nest_settings(make_access_settings(register.revoke("viewer-ben"), make_fleet()))["access_control"]
    assert (access["enabled"], access["default_permission"]) == (True, "deny")
    assert [each["cert_common_names"] for each in access["subjects"][1:]] == [["host-left.3"], ["viewer-anna.1"]]
    ids = [rule["id"] for rule in access["rules"]]
    assert len(ids) == len(set(ids))
    assert {rule for policy in access["policies"] for rule in policy["rules"]} == set(ids)
    anna = [rule for rule in access["rules"] if rule["id"].startswith("viewer-anna.1 ")]
    assert {message for rule in anna for message in rule["messages"]}.isdisjoint({"put", "reply", "liveliness_token"})


def test_keys_of_another_fleet_are_refused() -> None:
    with pytest.raises(Refusal, match="the keys are of fleet lab, and the file is of fleet other"):
        make_access_settings(Register(fleet="lab", authority=""), make_fleet("other"))


def test_settings_become_one_object() -> None:
    assert nest_settings({"a/b": 1, "a/c/d": 2, "e": 3}) == {"a": {"b": 1, "c": {"d": 2}}, "e": 3}
