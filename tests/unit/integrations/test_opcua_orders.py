"""Job orders of OPC 10031-4 as jobs, states and results; without the protocol's library."""

from collections.abc import Callable
from dataclasses import replace
from datetime import UTC, datetime, timedelta
from pathlib import Path
from xml.etree import ElementTree

import pytest
from click.testing import CliRunner

from integrations.opcua.command import opcua
from integrations.opcua.orders import Order, OrderParameter, OrderRequest
from integrations.opcua.reasons import find_axis_reason
from integrations.opcua.states import (
    ABORTED,
    AWAITS_START,
    ENDED,
    HELD,
    INTERRUPTED,
    READY,
    RUNNING,
    WAITING,
    OrderState,
    find_state,
    find_status,
    matches,
)
from integrations.opcua.work_masters import load_work_masters
from integrations.whole_fleet import describe
from tutti import AxisState, FileError, Refusal, Template

NOW = datetime(2026, 5, 4, 12, 0, tzinfo=UTC)
TEXT = """
schema: tutti.job/1
name: shift
parameters:
  way: {type: quantity, unit: mm, min: 0.1 mm, max: 40 mm}
  label: {type: text, default: test}
steps:
  - {do: move, by: {gantry.x: "${way}"}}
"""


@pytest.fixture
def templates(tmp_path: Path) -> dict[str, Template]:
    (tmp_path / "shift.template.job.yaml").write_text(TEXT)
    (tmp_path / "notes.txt").write_text("no template")
    return load_work_masters(tmp_path)


@pytest.fixture
def request_of_5_mm() -> OrderRequest:
    return OrderRequest("order 1", ("shift",), (OrderParameter("way", 5.0, "mm"),), priority=3)


@pytest.mark.parametrize(
    ("state", "reason", "held", "ready", "meant"),
    [
        ("queued", "submitted", False, False, READY),
        ("queued", "gantry is in use", False, False, WAITING),
        ("queued", "held", True, False, HELD),
        ("queued", "the cause is gone", False, True, AWAITS_START),
        ("planning", "", False, False, RUNNING),
        ("armed", "", False, False, RUNNING),
        ("running", "", False, False, RUNNING),
        ("paused", "", False, False, INTERRUPTED),
        ("done", "", False, False, ENDED),
        ("failed", "", False, False, ABORTED),
        ("cancelled", "", False, False, ABORTED),
        ("aborted", "", False, False, ABORTED),
        ("interrupted", "", False, False, ABORTED),
    ],
)
def test_states_of_jobs_are_those_of_orders(
    state: str, reason: str, held: bool, ready: bool, meant: OrderState
) -> None:
    assert find_state(state, reason, held=held, ready=ready) == meant


def test_states_have_the_numbers_of_the_nodeset() -> None:
    """The StateNumber of each state, as the vendored file has it."""
    numbers = read_state_numbers()
    for state in (HELD, AWAITS_START, READY, RUNNING, INTERRUPTED, ENDED, ABORTED):
        assert state.number == numbers["ISA95JobOrderReceiverObjectType", state.name]
        if state.substate:
            assert state.substate_number == numbers[SUBSTATE_TYPES[state.name], state.substate]


SUBSTATE_TYPES = {
    "NotAllowedToStart": "ISA95PrepareStateMachineType",
    "AllowedToStart": "ISA95PrepareStateMachineType",
    "Interrupted": "ISA95InterruptedStateMachineType",
    "Ended": "ISA95EndedStateMachineType",
}


def read_state_numbers() -> dict[tuple[str, str], int]:
    """The numbers of states, by their type and name, as the vendored nodeset has them."""
    root = ElementTree.parse("integrations/opcua/nodesets/opc.ua.isa95-jobcontrol.nodeset2.xml").getroot()
    nodes = {node.attrib["NodeId"]: node for node in root if "NodeId" in node.attrib}
    numbers: dict[tuple[str, str], int] = {}
    for node in nodes.values():
        if node.attrib["BrowseName"] == "StateNumber":
            state = nodes[node.attrib["ParentNodeId"]]
            kind = nodes[state.attrib["ParentNodeId"]]
            names = [part.attrib["BrowseName"].removeprefix("1:") for part in (kind, state)]
            value = next(part for part in node if part.tag.endswith("Value"))
            numbers[names[0], names[1]] = int("".join(value.itertext()))
    return numbers


@pytest.mark.parametrize(
    ("error", "bit"),
    [
        (Refusal("unknown-order", "no"), 1),
        (Refusal("unknown-job", "no"), 1),
        (Refusal("not-queued", "it runs"), 3),
        (Refusal("not-paused", "it runs"), 3),
        (Refusal("soft-limit", "too far"), 4),
        (Refusal("cause-lasts", "the door is open"), 4),
        (Refusal("bad-order", "wrong"), 32),
        (FileError([]), 32),
    ],
)
def test_refusals_are_bits_of_the_return_status(error: Refusal | FileError, bit: int) -> None:
    assert find_status(error) == 1 << bit


def test_a_refusal_is_told_with_its_remedy() -> None:
    assert describe(Refusal("soft-limit", "x is too far", "choose less")) == "x is too far; choose less"
    assert describe(Refusal("soft-limit", "x is too far")) == "x is too far"


def test_states_are_matched_by_numbers() -> None:
    assert matches(ENDED, 5, []) and matches(ENDED, 5, [1])
    assert not matches(ENDED, 5, [2]) and not matches(ENDED, 6, [])


def test_an_order_is_a_job_with_its_parameters(templates: dict[str, Template], request_of_5_mm: OrderRequest) -> None:
    job, terms = request_of_5_mm.make_job(templates, NOW)
    assert job.parameters_used == {"way": "5.0 mm", "label": "test", "JobOrderID": "order 1", "WorkMasterID": "shift"}
    assert (terms.priority, terms.at, terms.held) == (3, None, False)
    again = OrderRequest.of(job, terms)
    assert again is not None and (again.id, again.work_masters, again.priority) == ("order 1", ("shift",), 3)
    assert {parameter.name: parameter.written for parameter in again.parameters} == {"way": "5.0 mm", "label": "test"}
    assert OrderRequest.of(job.model_copy(update={"parameters_used": {"way": "5 mm"}}), terms) is None


def test_a_unit_is_converted_and_a_number_is_in_that_of_the_template(templates: dict[str, Template]) -> None:
    for value, unit, text in ((5.0, "", "5 mm"), (500.0, "um", "500.0 um"), ("0.5 cm", "", "0.5 cm")):
        order = OrderRequest("a", ("shift",), (OrderParameter("way", value, unit),))
        assert order.make_job(templates, NOW)[0].parameters_used["way"] == text


def test_an_order_begins_at_its_time_unless_that_is_over(
    templates: dict[str, Template], request_of_5_mm: OrderRequest
) -> None:
    later = NOW + timedelta(hours=1)
    for start, at in ((later, "2026-05-04T13:00:00.000000Z"), (NOW, None), (NOW - timedelta(days=1), None)):
        assert replace(request_of_5_mm, start=start).make_job(templates, NOW)[1].at == at


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda order: replace(order, id=""), "the JobOrderID is no name"),
        (lambda order: replace(order, id="a\nb"), "the JobOrderID is no name"),
        (lambda order: replace(order, id="a" * 121), "the JobOrderID is no name"),
        (lambda order: replace(order, work_masters=()), "the job order names no work master"),
        (lambda order: replace(order, work_masters=("mill",)), "the work master mill is unknown"),
        (lambda order: replace(order, priority=101), "priority 101 is out of range"),
        (lambda order: replace(order, unmet=("MaterialRequirements",)), "has MaterialRequirements, which this"),
        (lambda order: replace(order, parameters=order.parameters * 2), "states a parameter twice"),
        (lambda order: replace(order, parameters=()), "way: has no default"),
        (lambda order: replace(order, parameters=(OrderParameter("way", 41.0),)), "must be at most 40 mm"),
        (lambda order: replace(order, parameters=(OrderParameter("way", 5.0, "deg"),)), "deg is a unit of angle"),
        (lambda order: replace(order, parameters=(OrderParameter("way", True),)), "way: "),
    ],
)
def test_a_wrong_order_is_refused_with_what_is_wrong(
    templates: dict[str, Template],
    request_of_5_mm: OrderRequest,
    change: Callable[[OrderRequest], OrderRequest],
    words: str,
) -> None:
    with pytest.raises((Refusal, FileError)) as caught:
        change(request_of_5_mm).make_job(templates, NOW)
    assert words in str(caught.value)
    assert find_status(caught.value) == 1 << 32


def test_templates_that_cannot_be_used_are_refused(tmp_path: Path) -> None:
    with pytest.raises(Refusal, match=r"has no file \*.job.yaml"):
        load_work_masters(tmp_path)
    (tmp_path / "shift.template.job.yaml").write_text(TEXT)
    (tmp_path / "shift.job.yaml").write_text(TEXT)
    with pytest.raises(Refusal, match="two files are the work master shift"):
        load_work_masters(tmp_path)
    (tmp_path / "shift.job.yaml").write_text(TEXT.replace("move", "mvoe"))
    (tmp_path / "shift.template.job.yaml").unlink()
    with pytest.raises(Refusal, match="mvoe"):
        load_work_masters(tmp_path)


def test_an_order_that_has_not_ended_has_its_reason_alone(request_of_5_mm: OrderRequest) -> None:
    order = Order(request_of_5_mm, "j1", WAITING, "gantry is in use", "why")
    assert order.list_results() == {"JobID": "j1", "Reason": "gantry is in use", "Comment": "why"}


@pytest.mark.parametrize(
    ("mode", "change", "reason"),
    [
        ("idle", {}, ""),
        ("offline", {"fault": "stall"}, "its controller is offline"),
        ("fault", {"fault": "stall"}, "stall"),
        ("fault", {}, "its controller has a fault"),
        ("idle", {"enabled": False}, "its motor is off"),
        ("idle", {"referenced": False}, "it is not referenced; home it"),
        ("idle", {"limit": "forward"}, "it stands at a limit switch: forward"),
    ],
)
def test_an_axis_has_a_reason_why_it_does_not_move(mode: str, change: dict[str, object], reason: str) -> None:
    fields = {"position": 0, "commanded": 0, "velocity": 0, "motor_position": 0, "raw_counts": 0}
    rest = {"commanded_counts": 0, "unit": "mm", "moving": False, "enabled": True, "referenced": True}
    assert find_axis_reason(mode, AxisState.model_validate({**fields, **rest, **change})) == reason


@pytest.mark.parametrize(
    ("interface", "words"),
    [
        ("192.0.2.1", "without certificates every client that reaches it moves the fleet"),
        ("lab", "lab is not an address"),
    ],
)
def test_a_server_for_others_needs_certificates(tmp_path: Path, interface: str, words: str) -> None:
    result = CliRunner().invoke(opcua, ["serve", "--templates", str(tmp_path), "--interface", interface])
    assert result.exit_code == 2 and words in result.stderr
