"""`docs/reference/bus.md` against a fleet at work: each key that it names is there, and each request that it shows is understood.

Requests are made of the page's own words, without the client.
"""

import json
import re
from pathlib import Path
from typing import Any

import pytest
from cluster.worlds import demo_fleet, demo_job, job, run_fleet, virtual_demo_fleet

import orchestrator.bus.states.frame
import orchestrator.model.jobs.live
import orchestrator.model.jobs.service
import orchestrator.model.messages
import orchestrator.model.operation.alarms
import orchestrator.model.operation.approval
import orchestrator.model.operation.recording
import orchestrator.model.operation.virtual_state
import orchestrator.model.report
import orchestrator.model.state
from orchestrator.bus.base import BusSample, RequestRefused
from orchestrator.bus.outcome import RequestOutcome
from orchestrator.model.base import Model
from orchestrator.model.jobs.job import Job
from orchestrator.runtime.virtual.fleet import VirtualFleet

PAGE = (Path(__file__).parents[2] / "docs" / "reference" / "bus.md").read_text(encoding="utf-8")
MODELS = {
    module.__name__.removeprefix("orchestrator.model."): module
    for module in (
        orchestrator.model.messages,
        orchestrator.model.operation.alarms,
        orchestrator.model.operation.approval,
        orchestrator.model.operation.recording,
        orchestrator.model.report,
        orchestrator.model.jobs.service,
        orchestrator.model.state,
        orchestrator.model.operation.virtual_state,
    )
} | {"live": orchestrator.model.jobs.live, "frame": orchestrator.bus.states.frame}

# Values for the fields that the page names.
EXAMPLES: dict[str, Any] = {
    "at_fleet_ns": None,
    "steps": [{"do": "move", "to": {"gantry.x": 1}}],
    "shown": "0123456789abcdef",
    "epoch": 1,
    "coordinator": "c1",
    "controllers": [],
    "actor": "reader",
    "alarm_id": "estop-fleet",
    "alarm_ids": [],
    "all": True,
    "after_entry": 0,
    "last_ns": None,
    "after_point": 0,
    "after_step": -1,
    "axes": ["gantry.x"],
    "after": None,
    "before": "none",
    "by": "",
    "by_day": True,
    "begin": None,
    "check": True,
    "client_key": "of mine",
    "command": "MG TIME",
    "count": 2,
    "data": "",
    "description": None,
    "digest": f"sha256:{'0' * 64}",
    "dry_run": False,
    "event": None,
    "first": 0,
    "for_s": None,
    "from_point": None,
    "from_step": 0,
    "history": 5,
    "holder": "manual-reader",
    "i_know": True,
    "job_id": "none",
    "job_ids": ["none"],
    "keep": 10,
    "limit": 5,
    "mode": "decelerate",
    "name": "",
    "number": 0,
    "now": False,
    "older_s": 1e6,
    "plan": f"sha256:{'0' * 64}",
    "reason": "",
    "renew": False,
    "reserve": False,
    "seq": 1,
    "reference": "last",
    "since": "2026-01-01T00:00:00Z",
    "state": None,
    "step": 0,
    "terms": {},
    "ttl_s": 2.0,
    "valid_ms": 150,
    "values": {},
    "velocities": {"gantry.x": 0.0},
    "what": "reading",
    "why": "",
}


MORE: dict[str, dict[str, Any]] = {
    "svc/list": {"since": "2026-01-01T00:00:00.000000Z", "before": ""},
    "svc/put-points": {"axes": [{"axis": "gantry.x", "unit": "mm"}], "begin": 0},
    "svc/commands": {"before": None},
    "svc/statistics": {"since": "2026-01-01"},
    "svc/override": {"percent": 50.0},
    "svc/retarget": {"to": {"gantry.x": 20}, "by": {}},
}
"""Fields whose value on the page is another one for this verb."""


SILENT = {
    "alarm/{id}": "there is no alarm",
    "lease/{id}/{axis}": "no make here lets axes of one controller move for different holders",
    "leads/{coordinator}": "only served",
    "kept-estop/{keeper}": "only served",
    "estop-reset": "published after a reset",
    "user/{name}": "of programs of users",
    "log/{role}/{id}": "in virtual time logs go to their sinks",
}


def section(title: str) -> list[tuple[str, str]]:
    """The rows of the table under a heading: first and second cell."""
    text = PAGE.partition(f"## {title}")[2].partition("\n## ")[0]
    rows = [
        line.strip("| ").split(" | ", 1) for line in text.splitlines() if line.startswith("| `") or " `live" in line
    ]
    return [(cells[0], cells[1]) for cells in rows if len(cells) == 2]


def shown_fields(cell: str) -> list[list[str]]:
    """The names in each of the braces that stand in code marks."""
    found: list[list[str]] = []
    for shown in re.findall(r"`\{([^`]*)\}`", cell):
        flat = re.sub(r"\[[^\]]*\]|\{[^}]*\}", "", shown)
        found.append([part.partition(":")[0].strip() for part in flat.split(",") if part.strip()])
    return found


def requests() -> list[tuple[str, list[str], list[str]]]:
    """Key, request's fields, answer's fields, of every verb of the page."""
    rows: list[tuple[str, list[str], list[str]]] = []
    for keys, cell in section("To act"):
        asked, _, answered = cell.partition("→")
        fields = shown_fields(asked)
        for key in re.findall(r"`([^`]+)`", keys):
            answers = shown_fields(answered)
            rows.append((key, fields[0] if fields else [], answers[0] if answers else []))
    return rows


def models_of(cell: str) -> list[type[Model]]:
    named = re.findall(r"`((?:operation\.)?\w+)\.([A-Z]\w+)`", cell)
    return [getattr(MODELS[module], name) for module, name in named]


def test_the_page_names_every_verb_of_the_service_and_nothing_else() -> None:
    async def main(fleet: VirtualFleet) -> set[str]:
        with pytest.raises(RequestRefused, match="known verbs:") as refused:
            await fleet.make_client().bus.request(f"{fleet.make_client().keys.prefix}/svc/no-such", b"{}", 1.0)
        return set(str(refused.value).partition("known verbs: ")[2].split(", "))

    named = {key.removeprefix("svc/") for key, _, _ in requests() if key.startswith("svc/")}
    assert named == run_fleet(main)


def test_every_request_of_the_page_is_understood_and_answered_as_it_says() -> None:
    rows = requests()
    assert len(rows) > 15

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        prefix = client.keys.prefix
        for number, (key, fields, answers) in enumerate(rows):
            request = {name: EXAMPLES[name] for name in fields if name != "request_id" and name in EXAMPLES}
            if "request_id" in fields:
                request["request_id"] = f"r{number}"
            if "job" in fields:
                request["job"] = json.loads(job("[{do: dwell, duration: 0.1 s}]").to_json())
            request |= MORE.get(key, {})
            if "configuration" in fields:
                request["configuration"] = demo_fleet().to_plain()
            assert set(request) == set(fields), f"{key}: no example of {set(fields) - set(request)}"
            full = f"{prefix}/{key}".replace("{id}", "gantry")
            payload = json.dumps(request).encode() if fields else b""
            answer = json.loads(await client.bus.request(full, payload, 30.0))
            assert set(answers) <= set(answer), f"{key} answers {sorted(answer)}"
            if fields:
                with pytest.raises(RequestRefused, match="no_such"):
                    await client.bus.request(full, json.dumps(request | {"no_such": 1}).encode(), 5.0)

    run_fleet(main)


def test_every_key_of_the_page_is_published_while_a_job_runs_and_contains_what_it_names() -> None:
    rows = [(key, cell) for keys, cell in section("To watch") for key in re.findall(r"`([^`]+)`", keys)]
    rows = [(key, cell) for key, cell in rows if not key.startswith("live/")]
    assert len(rows) >= 9

    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        heard: dict[str, list[BusSample]] = {key: [] for key, _ in rows}
        for key, _ in rows:
            expression = re.sub(r"\{\w+\}", "*", f"{client.keys.prefix}/{key}")
            await client.bus.subscribe(expression, heard[key].append)
        run: Job = demo_job()
        triggers = "triggers: [{output: gantry.lamp, every: 50 ms}]"
        sampled = job(f"[{{do: move, by: {{gantry.x: 5}}, record: {{axes: [gantry.x], period: 5 ms}}, {triggers}}}]")
        assert (await client.wait_for_job(await client.submit(run))).state == "done"
        assert (await client.wait_for_job(await client.submit(sampled))).state == "done"
        async with client.live("gantry.x") as live:
            await live.move(by={"gantry.x": -1})
        # One that ends badly is warned of.
        assert (
            await client.wait_for_job(await client.submit(job("[{do: wait, input: gantry.door, timeout: 100 ms}]")))
        ).state != "done"
        for key, cell in rows:
            models = models_of(cell)
            if key in SILENT:
                continue
            assert heard[key], f"nothing on {key}"
            assert models, f"{key} names no model"
            for sample in heard[key]:
                if sample.payload:
                    models[0].model_validate_json(sample.payload.partition(b"\n")[0])

    run_fleet(main, virtual_demo_fleet())


def test_a_request_that_comes_twice_is_done_once() -> None:
    async def main(fleet: VirtualFleet) -> None:
        client = fleet.make_client()
        key = f"{client.keys.prefix}/svc/submit"
        request = {"actor": "reader", "job": json.loads(job("[{do: dwell, duration: 0.1 s}]").to_json())}
        first = request | {"request_id": "one", "client_key": "a"}
        answers = [await client.bus.request(key, json.dumps(first).encode(), 5.0) for _ in range(2)]
        assert answers[0] == answers[1]
        prune = {"request_id": "two", "actor": "reader", "older_s": 0.0, "keep": 0}
        await client.wait_for_job(json.loads(answers[0])["job_id"])
        prunes = [
            await client.bus.request(f"{client.keys.prefix}/svc/prune", json.dumps(prune).encode(), 5.0)
            for _ in range(2)
        ]
        assert [json.loads(each)["jobs"] for each in prunes] == [1, 1]

    run_fleet(main)


def test_looking_around_on_the_whole_fleet_gets_values_and_no_errors(monkeypatch: pytest.MonkeyPatch) -> None:
    refusals: list[str] = []
    monkeypatch.setattr(RequestOutcome, "add_refusal", lambda _, text: refusals.append(text))

    async def main(fleet: VirtualFleet) -> set[str]:
        client = fleet.make_client()
        found = await client.bus.request_all(f"{client.keys.prefix}/**", b"", 5.0)
        own = [key.removeprefix(client.keys.prefix + "/") for key in found]
        return {re.sub("^(leads|kept-estop)/.*", r"\1", key) for key in own}

    per_controller = {f"ctl/{c}/{leaf}" for c in ("gantry", "stage") for leaf in ("state", "info", "clock")}
    leases = {"lease/gantry", "lease/stage"}
    assert per_controller | leases | {"host/local/states", "time", "leads", "kept-estop"} == {
        key for key in run_fleet(main) if key.count("/") < 3
    }
    assert refusals == []
