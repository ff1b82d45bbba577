"""Alarms: every state with every event, ids, and the sections of the fleet file."""

import re
from typing import get_args

import pytest

from orchestrator.model.base import ID_PATTERN
from orchestrator.model.fleet import Fleet
from orchestrator.model.jobs.files import FileError, parse_document
from orchestrator.model.operation.alarms import AlarmCause, AlarmRecord, AlarmState, make_alarm_id
from orchestrator.model.operation.transitions import (
    TRANSITIONS,
    AlarmEvent,
    acknowledge_alarm,
    raise_alarm,
    return_alarm,
    set_out_of_service,
    shelve_alarm,
    unshelve_alarm,
)

CAUSE = AlarmCause("disconnected", "gantry", "gantry is offline", "check the cable")
STATES: tuple[AlarmState, ...] = get_args(AlarmState)
T0, T1, T2 = (f"2026-01-01T00:00:0{n}.000000Z" for n in range(3))


def record(state: AlarmState) -> AlarmRecord:
    """An alarm that has come to `state` by its own way."""
    new = raise_alarm(None, CAUSE, T0)
    match state:
        case "unacknowledged":
            return new
        case "acknowledged":
            return acknowledge_alarm(new, "anna", T1)
        case "returned":
            return return_alarm(new, T1)
        case "normal":
            return return_alarm(acknowledge_alarm(new, "anna", T1), T1)


def test_the_table_has_every_state_with_every_event() -> None:
    assert set(TRANSITIONS) == {(state, event) for state in STATES for event in get_args(AlarmEvent)}


@pytest.mark.parametrize("state", STATES)
def test_each_function_follows_the_table(state: AlarmState) -> None:
    before = record(state)
    assert before.state == state
    assert raise_alarm(before, CAUSE, T2).state == TRANSITIONS[state, "raise"]
    assert return_alarm(before, T2).state == TRANSITIONS[state, "return"]
    assert acknowledge_alarm(before, "ben", T2).state == TRANSITIONS[state, "acknowledge"]
    shelved = shelve_alarm(before, T2, "anna", "known")
    assert (shelved.state, shelved.is_open, shelved.shelved_by) == (state, False, "anna")
    assert unshelve_alarm(shelved).state == TRANSITIONS[state, "annunciate"]
    serviced = set_out_of_service(before, "reserved by anna")
    assert (serviced.state, serviced.is_open) == (state, False)
    assert set_out_of_service(serviced, "").state == TRANSITIONS[state, "annunciate"]


def test_what_changes_nothing_returns_the_same_record() -> None:
    active = record("unacknowledged")
    assert raise_alarm(active, CAUSE._replace(text="other"), T2) is active
    assert unshelve_alarm(active) is active and set_out_of_service(active, "") is active
    assert acknowledge_alarm(record("normal"), "ben", T2).acknowledged_by == "anna"
    assert return_alarm(record("returned"), T2).returned_utc == T1


def test_a_new_raise_counts_and_forgets_the_acknowledgement() -> None:
    again = raise_alarm(record("normal"), CAUSE._replace(text="again"), T2)
    assert (again.count, again.text, again.raised_utc) == (2, "again", T2)
    assert (again.acknowledged_by, again.returned_utc) == (None, None)


def test_an_alarm_that_is_set_aside_twice_comes_back_only_after_both() -> None:
    both = set_out_of_service(shelve_alarm(record("acknowledged"), T2, "anna", ""), "reserved")
    one = unshelve_alarm(both)
    assert (one.state, one.is_open) == ("acknowledged", False)
    back = set_out_of_service(one, "")
    assert (back.state, back.is_open, back.acknowledged_by) == ("unacknowledged", True, None)
    # Raised anew meanwhile, it stays aside.
    assert raise_alarm(shelve_alarm(record("normal"), T2, "anna", "x"), CAUSE, T2).shelved_why == "x"


def test_ids_are_stable_and_tell_causes_apart() -> None:
    assert make_alarm_id("disconnected", "gantry") == "disconnected-gantry"
    assert make_alarm_id("following-error", "gantry.x") == "following-error-gantry_x"
    causes = [
        ("fault", "gantry", "a-b"),
        ("fault", "b-gantry", "a"),
        ("budget", "a_b.c", ""),
        ("budget", "a.b_c", ""),
        ("fault", "gantry", "Ärger / 1"),
        ("fault", "gantry", "Ärger / 2"),
        ("fault", "g" * 64, "a" * 64),
    ]
    ids = [make_alarm_id(kind, subject, code) for kind, subject, code in causes]
    ids.append(make_alarm_id("fault", "gantry", "a-b", "recorder/r1"))
    assert len(set(ids)) == len(ids) and all(re.match(ID_PATTERN, each) and len(each) <= 64 for each in ids)


FLEET = """schema: tutti.fleet/1
fleet: demo
controllers:
  gantry:
    adapter: smc4000
    link: {kind: tcp, host: 127.0.0.1, port: 2023}
    axes: {x: {motors: [X], unit: mm, limits: {velocity: 200, acceleration: 1000}}}
"""


def load(more: str) -> Fleet:
    return parse_document(f"{FLEET}{more}\n", Fleet, "f.yaml")


def test_rules_have_defaults_and_are_changed_one_by_one() -> None:
    plain, changed = (
        load("").alarms,
        load("alarms: {disconnected: {for: 2 s, priority: low}, budget: {limit: 50%}}").alarms,
    )
    assert (plain.disconnected.for_, plain.disconnected.priority) == (10_000_000_000, "high")
    assert (changed.disconnected.for_, changed.disconnected.priority) == (2_000_000_000, "low")
    assert (changed.budget.limit, changed.budget.steps) == (0.5, 10)
    assert load("").notify is None
    again = Fleet.model_validate_json(load("alarms: {disconnected: {for: 2 s}}").to_json())
    assert again.alarms.disconnected.for_ == 2_000_000_000


@pytest.mark.parametrize(
    ("more", "expected"),
    [
        ("alarms: {disconected: {}}", "f.yaml:8: alarms.disconected: unknown field"),
        ("alarms: {budget: {limit: 8}}", "f.yaml:8: alarms.budget.limit: found 8"),
        ("alarms: {disconnected: {for: 2}}", "f.yaml:8: alarms.disconnected.for: 2 is not a duration"),
        ("alarms: {fault: {priority: urgent}}", "f.yaml:8: alarms.fault.priority: found 'urgent'; allowed: 'high'"),
        ("alarms: {link_errors: {limit: 0}}", "f.yaml:8: alarms.link_errors.limit: found 0"),
        ("notify: {command: page}", "f.yaml:8: notify.command: found 'page'"),
        ("notify: {command: []}", "f.yaml:8: notify.command"),
        ("notify: {command: ['']}", "the program is empty; write e.g."),
        ("notify: {command: [a], timeout: 2 days}", "f.yaml:8: notify.timeout: '2 days' is not a duration"),
    ],
)
def test_mistakes_are_named_with_place_value_and_remedy(more: str, expected: str) -> None:
    with pytest.raises(FileError) as caught:
        load(more)
    assert expected in str(caught.value)
