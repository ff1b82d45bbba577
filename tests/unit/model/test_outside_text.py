"""Text from outside is shown and never obeyed; new names with such characters are refused."""

import json

import pytest

from orchestrator.bus.latch import EstopMessage
from orchestrator.model.jobs.job import Job
from orchestrator.model.messages import StopRequest
from orchestrator.model.script import WrongValue
from orchestrator.model.text.outside_text import has_hidden, show_json, show_text
from tutti import Dwell, Move

HOSTILE = "x\x1b[2J\r\n\u202eevil\u200b\x9b\x7f\t\ufeff end"
SHOWN = "x\\x1b[2J\\r\\n\\u202eevil\\u200b\\x9b\\x7f\\t\\ufeff end"


@pytest.mark.parametrize("text", ["", "plain", "µm 12,5 é ü 漢字 😀", 'a "quoted" \\n path C:\\temp'])
def test_what_can_be_seen_is_not_changed(text: str) -> None:
    assert show_text(text) == text
    for payload in (json.dumps({"name": text}), json.dumps({"name": text}, ensure_ascii=False)):
        assert json.loads(show_json(payload.encode())) == {"name": text}


@pytest.mark.parametrize("ascii_only", [True, False])
def test_json_is_shown_before_it_is_decoded_as_its_texts_are_after(ascii_only: bool) -> None:
    payload = json.dumps({"name": HOSTILE, HOSTILE: [HOSTILE, 1, None]}, ensure_ascii=ascii_only).encode()
    assert json.loads(show_json(payload)) == {"name": SHOWN, SHOWN: [SHOWN, 1, None]}
    assert show_text(HOSTILE) == SHOWN
    assert show_text(SHOWN) == SHOWN
    assert not has_hidden(SHOWN)


def test_an_escaped_backslash_is_no_escape() -> None:
    payload = json.dumps({"path": "C:\\new\\table\\u001b"}).encode()
    assert json.loads(show_json(payload)) == {"path": "C:\\new\\table\\u001b"}


def test_half_a_pair_stays_an_error_of_the_decoder() -> None:
    with pytest.raises(ValueError, match=r"surrogate|unicode|escape"):
        EstopMessage.read_message(b'{"event": "\\ud800", "actor": "", "reason": ""}')


@pytest.mark.parametrize("name", [HOSTILE, "a\nb", "gantry\u202e", "zero\u200bwidth"])
def test_a_new_name_with_a_hidden_character_is_refused_with_its_place(name: str) -> None:
    for make in (lambda: Job(name, [Dwell(duration="1 s")]), lambda: Move(name=name, to={"a.x": 1})):
        with pytest.raises(WrongValue, match="has a character that is not shown") as refused:
            make()
        assert not has_hidden(str(refused.value))


def test_a_job_that_is_stored_already_is_read_and_shown() -> None:
    body = Job("x", [Dwell(duration="1 s")]).to_plain() | {"name": HOSTILE}
    assert Job.read_stored(json.dumps(body)).name == SHOWN


def test_a_stop_is_never_refused_for_its_words() -> None:
    fields = {"request_id": HOSTILE, "actor": HOSTILE, "reason": HOSTILE}
    stop = StopRequest.model_validate_json(json.dumps(fields))
    assert (stop.actor, stop.reason) == (SHOWN, SHOWN)
    estop = EstopMessage.read_message(json.dumps({"event": HOSTILE, "actor": HOSTILE, "reason": HOSTILE}).encode())
    assert (estop.event, estop.actor, estop.reason) == (SHOWN, SHOWN, SHOWN)
