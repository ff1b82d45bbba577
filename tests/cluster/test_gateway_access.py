"""The gateway's doors: roles, sessions, tokens, origins, sizes; verbs over HTTP."""

import asyncio
import json
from pathlib import Path
from typing import Any

import pytest
from cluster.gateway_client import OWN, PASSWORD, PORT, VirtualGateway, run_with_gateway
from cluster.worlds import EXAMPLES, PREPARE, demo_fleet, outcome

from orchestrator.bus.service_verbs import CONTROLLER_VERBS, SERVICE_VERBS
from orchestrator.gateway.access.roles import LEAST_ROLES, ROLES, Role, may
from orchestrator.gateway.access.users import StoredToken
from orchestrator.model.fleet import Fleet
from orchestrator.model.queue import shift_utc
from orchestrator.model.web_views import WebSettings, WebView
from orchestrator.runtime.virtual.fleet import VirtualFleet

USERS: dict[str, Role] = {"vera": "viewer", "paul": "proposer", "olga": "operator", "mia": "maintainer"}
JOB = {"schema": "tutti.job/1", "name": "there", "steps": [{"do": "dwell", "duration": "1 s"}]}

# The whole table, written out: a right that is given by mistake is a difference here.
RIGHTS: dict[Role, set[str]] = {
    "viewer": {
        *("alarms", "commands", "configuration", "find", "list", "names", "plan", "points", "positions", "recording"),
        *("virtual", "zones"),
        *("show", "statistics", "stop", "estop", "preview-start", "read-live"),
    },
    "proposer": {"submit", "put-points", "dry-run", "check-job"},
    "operator": {
        *(
            "approve",
            "cancel",
            "retry",
            "hold",
            "release",
            "reorder",
            "pause",
            "resume",
            "override",
            "start-queue",
            "stop-queue",
        ),
        *("acknowledge", "shelve", "save-position", "acquire-axes", "release-axes", "jog", "work", "reset"),
        *("check-fleet", "check-wiring", "ask-live", "stop-live", "end-live", "retarget", "go"),
    },
    "maintainer": {"remove-position", "prune", "reload", "hand-over", "repair-epoch", "forget-times", "forget", "raw"},
}


async def open_gateway(fleet: VirtualFleet, folder: Path, **roles: Role) -> VirtualGateway:
    gateway = VirtualGateway(fleet, folder, roles)
    await gateway.start()
    return gateway


@pytest.mark.parametrize("role", ROLES)
def test_the_table_of_roles_and_verbs(role: Role) -> None:
    allowed = {verb for each in ROLES[: ROLES.index(role) + 1] for verb in RIGHTS[each]}
    assert {verb for verb in LEAST_ROLES if may(role, verb)} == allowed


def test_every_verb_has_a_least_role() -> None:
    assert set(LEAST_ROLES) >= SERVICE_VERBS.keys() | CONTROLLER_VERBS.keys()


def test_every_verb_is_refused_below_its_role_and_passed_on_from_it(tmp_path: Path) -> None:
    """Over HTTP, and over the socket: what matters is the answer, not what a page shows."""

    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, **USERS)
        paths = {verb: f"/v1/{verb}" for verb in LEAST_ROLES if verb != "work"}
        paths |= {verb: f"/v1/controllers/gantry/{verb}" for verb in CONTROLLER_VERBS}
        frames = {"jog": "jog", "work": "work", "acquire-axes": "acquire", "ask-live": "live-begin"}
        for user, role in USERS.items():
            session = await gateway.sign_in(user)
            for verb, path in paths.items():
                if verb in ("stop", "estop"):
                    continue
                answer = await gateway.post(path, {}, session)
                assert (answer.refused == "not-allowed") == (not may(role, verb)), (user, verb, answer.body)
            socket = await gateway.connect(session)
            for verb, frame in frames.items():
                answer = await socket.ask(frame, axes=["gantry"], axis="gantry.x", velocity=1)
                code = answer.get("refused", {}).get("code", "")
                assert (code == "not-allowed") == (not may(role, verb)), (user, verb)
            assert "ok" in await socket.ask("stop")
            assert (await gateway.post("/v1/stop", {}, session)).status == 200
            assert (await gateway.post("/v1/estop", {}, session)).status == 200
            await fleet.make_client().reset()

    run_with_gateway(main)


def test_without_a_session_nothing_is_answered(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, olga="operator")
        for headers in (
            {},
            {"cookie": "tutti_session_demo_8080=forged"},
            {"cookie": "tutti_session_demo_8080=" + "x" * 5000},
            {"cookie": "\x00;;==;"},
            {"authorization": "Bearer tutti_olga_forged"},
            {"authorization": "Bearer"},
            {"authorization": "Basic b2xnYTpjb3JyZWN0IGhvcnNl"},
        ):
            for path in ("/v1/session", "/v1/state", "/v1/jobs", "/v1/openapi.json"):
                assert (await gateway.get(path, headers)).status == 401
            for path in ("/v1/stop", "/v1/submit", "/v1/estop"):
                assert (await gateway.post(path, {}, headers)).status == 401
            socket = await gateway.connect(headers)
            assert socket.denied is not None and socket.denied.status == 401
        assert (await gateway.get("/")).status == 404  # the page itself is no secret; here it is not built

    run_with_gateway(main)


def test_cameras_of_the_fleet_file_are_in_the_state_and_in_the_policy_of_the_page(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        await outcome(fleet, PREPARE)
        before = await gateway.get("/v1/state")
        assert "views" not in before.json and "frame-src" not in before.headers["content-security-policy"]
        socket = await gateway.connect()
        views = [
            WebView(title="From above", url="http://camera-1.lab:8080/stream.mjpg"),
            WebView(title="Side", url="https://media.lab/side", kind="page"),
        ]
        file = fleet.fleet.model_copy(update={"web": WebSettings(views=views)})
        assert await fleet.make_client().reload_fleet(file) == []
        await socket.wait_for(lambda: "views" in socket.state)
        assert socket.state["views"] == [view.to_plain() for view in views]
        policy = (await gateway.get("/v1/state")).headers["content-security-policy"]
        assert "img-src 'self' data: blob: http://camera-1.lab:8080; frame-src https://media.lab;" in policy

    run_with_gateway(main)


def test_a_command_in_the_controllers_own_language_acquires_its_axes_meanwhile(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, mia="maintainer", olga="operator")
        await outcome(fleet, PREPARE)
        session, path = await gateway.sign_in("mia"), "/v1/controllers/gantry/raw"
        body = {"command": "MG _TPX", "i_know": True}
        answer = await gateway.post(path, body, session)
        assert answer.status == 200 and answer.json["refused"] is None and answer.json["reply"]
        client = fleet.make_client()
        assert not [
            lease.holder for lease in await client.list_leases() if lease.controller == "gantry" and lease.holder
        ]
        assert (await gateway.post(path, {"command": "MG _TPX"}, session)).refused == "raw-needs-flag"
        for wrong in ({}, {"command": 5, "i_know": True}, {"command": "x" * 4001, "i_know": True}, {**body, "now": 1}):
            assert (await gateway.post(path, wrong, session)).refused == "bad-request", wrong
        assert (await gateway.post(path, body, await gateway.sign_in("olga"))).refused == "not-allowed"
        async with client.manual_control(["gantry.x"], what="alignment"):
            answer = await gateway.post(path, body, session)
            assert answer.refused == "leased" and "alignment" in str(answer.body)
        holder = {**body, "holder": "manual-none"}
        assert (await gateway.post(path, holder, session)).json["refused"]["code"] == "not-leased"
        schemas = (await gateway.get("/v1/openapi.json", session)).json["components"]["schemas"]
        assert schemas["RawRequest"]["required"] == ["command"]

    run_with_gateway(main)


def test_a_session_needs_its_csrf_token_for_what_changes_something(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, olga="operator", mia="maintainer")
        session, other = await gateway.sign_in("olga"), await gateway.sign_in("mia")
        only_cookie = {"cookie": session["cookie"]}
        assert (await gateway.get("/v1/state", only_cookie)).status == 200
        for token in ({}, {"x-tutti-csrf": ""}, {"x-tutti-csrf": other["x-tutti-csrf"]}):
            answer = await gateway.post("/v1/stop-queue", {}, only_cookie | token)
            assert (answer.status, answer.refused) == (403, "bad-csrf")
        assert (await gateway.post("/v1/stop-queue", {}, session)).status == 200

    run_with_gateway(main)


def test_the_cookie_is_for_this_site_and_no_script(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, olga="operator")
        answer = await gateway.post("/v1/login", {"user": "olga", "password": PASSWORD})
        words = answer.headers["set-cookie"].lower()
        assert "httponly" in words and "samesite=strict" in words and "path=/" in words
        assert "default-src 'self'" in answer.headers["content-security-policy"]

    run_with_gateway(main)


def test_other_computers_reach_it_by_the_names_of_its_certificate_alone(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = VirtualGateway(fleet, tmp_path, {"olga": "operator"}, names=("tutti.lab", "192.0.2.5"))
        await gateway.start()
        named, plain = {"host": f"tutti.lab:{PORT}"}, "http://tutti.lab:8080"
        answer = await gateway.post("/v1/login", {"user": "olga", "password": PASSWORD}, named)
        assert answer.status == 200 and "secure" in answer.headers["set-cookie"].lower()
        assert answer.headers["strict-transport-security"] == "max-age=2592000"
        session = {"cookie": answer.headers["set-cookie"].partition(";")[0], "x-tutti-csrf": answer.json["csrf"]}
        assert (
            await gateway.post("/v1/stop", {}, named | session | {"origin": f"https://{named['host']}"})
        ).status == 200
        assert (await gateway.get("/v1/state", {"host": f"192.0.2.5:{PORT}"} | session)).status == 200
        own = await gateway.get("/v1/state", session)  # 127.0.0.1, where other pages may be plain
        assert own.status == 200 and "strict-transport-security" not in own.headers
        for wrong in ({"host": f"evil.example:{PORT}"}, {"host": "tutti.lab"}, named | {"origin": plain}):
            answer = await gateway.post("/v1/stop", {}, session | wrong)
            assert (answer.status, answer.refused) in ((403, "bad-host"), (403, "bad-origin"))
        # The certificate ends: what is open stays, and nothing new comes by these names.
        socket = await gateway.connect(named | session)
        gateway.gateway.guard.admit((), "its certificate has expired")
        refused = await gateway.post("/v1/stop", {}, named | session)
        assert refused.refused == "bad-host" and "has expired" in refused.json["refused"]["text"]
        assert "ok" in await socket.ask("stop")
        assert (await gateway.get("/v1/state", session)).status == 200

    run_with_gateway(main)


def test_where_other_computers_reach_it_nothing_is_let_in_when_the_last_user_is_gone(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = VirtualGateway(fleet, tmp_path, {"olga": "operator"}, names=("tutti.lab",))
        await gateway.start()
        session = await gateway.sign_in("olga")
        socket = await gateway.connect(session)
        gateway.users.remove_user("olga")
        await asyncio.sleep(1.5)
        assert socket.closed is not None
        for headers in ({}, session, {"host": f"tutti.lab:{PORT}"}):
            answer = await gateway.post("/v1/stop", {}, headers)
            assert (answer.status, answer.refused) == (401, "no-users")

    run_with_gateway(main)


def test_a_session_ends_by_sign_out_and_with_its_user(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, olga="operator", mia="maintainer")
        session = await gateway.sign_in("olga")
        await gateway.post("/v1/logout", {}, session)
        assert (await gateway.get("/v1/state", session)).status == 401
        for change in (
            lambda: gateway.users.change_role("olga", "viewer", fleet.clock.utc()),
            lambda: gateway.users.change_password("olga", PASSWORD, fleet.clock.utc()),
            lambda: gateway.users.remove_user("olga"),
        ):
            session = await gateway.sign_in("olga")
            socket = await gateway.connect(session)
            assert (await gateway.get("/v1/state", session)).status == 200
            await asyncio.sleep(1.0)
            change()
            await asyncio.sleep(1.5)
            assert (await gateway.get("/v1/state", session)).status == 401
            assert socket.closed == 4401

    run_with_gateway(main)


def test_sign_ins_that_fail_take_longer_and_longer(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, olga="operator")
        statuses: list[int] = []
        for _ in range(8):
            answer = await gateway.post("/v1/login", {"user": "olga", "password": "wrong password"})
            statuses.append(answer.status)
        assert statuses == [401] * 5 + [429] * 3
        assert (await gateway.post("/v1/login", {"user": "olga", "password": PASSWORD})).status == 429
        await asyncio.sleep(2.0)
        assert (await gateway.post("/v1/login", {"user": "olga", "password": PASSWORD})).status == 200
        assert (await gateway.post("/v1/login", {"user": "eve", "password": PASSWORD})).status == 401

    run_with_gateway(main)


def test_a_token_has_its_own_limits(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, olga="operator")
        utc = fleet.clock.utc()
        stored = StoredToken(
            digest="", role="maintainer", verbs=["submit"], created_utc=utc, expires_utc=shift_utc(utc, 5)
        )
        secret = gateway.users.add_token("olga", "ci", stored, "secret")
        await asyncio.sleep(1.0)
        headers = {"authorization": f"Bearer {secret}"}
        session = await gateway.get("/v1/session", headers)
        assert session.json["role"] == "operator"  # at most that of its user
        assert session.json["may"] == ["estop", "stop", "submit"]
        answer = await gateway.post("/v1/submit", {"job": JOB}, headers)
        assert answer.status == 200, answer.body
        shown = await fleet.make_client().show_job(answer.json["job_id"])
        assert shown.entry is not None and shown.entry.actor == "olga/ci@127.0.0.1"
        assert (await gateway.post("/v1/hold", {"job_ids": []}, headers)).refused == "not-allowed"
        await asyncio.sleep(5)
        assert (await gateway.post("/v1/submit", {"job": JOB}, headers)).refused == "token-expired"
        gateway.users.remove_token("olga", "ci")
        await asyncio.sleep(1.0)
        assert (await gateway.post("/v1/submit", {"job": JOB}, headers)).refused == "bad-token"

    run_with_gateway(main)


def test_a_file_of_users_that_cannot_be_read_lets_nothing_in(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, olga="operator")
        session = await gateway.sign_in("olga")
        gateway.users.path.write_text('{"users": {"eve": {"role": "god"}}}')
        await asyncio.sleep(1.0)
        for headers in (session, {}):
            answer = await gateway.get("/v1/state", headers)
            assert (answer.status, answer.refused) == (401, "bad-users")
            assert "users.json" in answer.json["refused"]["text"]

    run_with_gateway(main)


@pytest.mark.parametrize("path", ["/v1/state", "/v1/stop", "/v1/submit"])
def test_another_host_or_origin_is_refused_and_a_stop_as_well(tmp_path: Path, path: str) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        method = "GET" if path == "/v1/state" else "POST"
        for headers, code in (
            ({"host": "evil.example:8080"}, "bad-host"),
            ({"host": "127.0.0.1:9999"}, "bad-host"),
            ({"host": ""}, "bad-host"),
            ({"origin": "http://evil.example"}, "bad-origin"),
            ({"origin": "http://127.0.0.1:9999"}, "bad-origin"),
            ({"origin": "https://127.0.0.1:8080"}, "bad-origin"),
            ({"origin": "null"}, "bad-origin"),
        ):
            answer = await gateway.request(method, path, None if method == "GET" else {}, headers)
            assert (answer.status, answer.refused) == (403, code)
            socket = await gateway.connect(headers)
            assert socket.denied is not None and socket.denied.status == 403
        assert not any("stop" in line for line in gateway.lines)
        for headers in ({"origin": "http://127.0.0.1:8080"}, {"host": "localhost:8080"}, OWN):
            assert (await gateway.request("GET", "/v1/state", None, headers)).status == 200

    run_with_gateway(main)


@pytest.mark.parametrize(
    ("body", "headers", "status"),
    [
        (b"{", {}, 400),
        (b"[1]", {}, 400),
        (b"\xff\xfe", {}, 400),
        (b"[" * 50_000, {}, 400),
        (b'{"job": 1}', {}, 400),
        (b"{}", {"content-type": "text/plain"}, 415),
        (b"x" * 4_100_000, {}, 413),
        (b"x" * 4_100_000, {"content-length": "10"}, 413),
        (b"{}", {"content-length": "many"}, 413),
        (b'{"job": {"steps": []}, "actor": "eve"}', {}, 400),
        (b'{"job": {"steps": []}, "more": 1}', {}, 400),
    ],
)
def test_a_body_that_is_not_right_is_refused(tmp_path: Path, body: bytes, headers: dict[str, str], status: int) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        answer = await gateway.request("POST", "/v1/submit", body, headers)
        assert answer.status == status, answer.body
        assert answer.json["refused"]["text"]

    run_with_gateway(main)


def test_wrong_passwords_of_others_keep_no_browser_out_that_was_signed_in_before(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, **USERS)
        answer = await gateway.post("/v1/login", {"user": "olga", "password": PASSWORD})
        cookies = answer.cookies
        assert {name: value[1:] for name, value in cookies.items()} == {
            "tutti_known_demo_8080_olga": ("HttpOnly", "Max-Age=34560000", "Path=/", "SameSite=strict"),
            "tutti_session_demo_8080": ("HttpOnly", "Max-Age=604800", "Path=/", "SameSite=strict"),
        }
        known = {"cookie": f"tutti_known_demo_8080_olga={cookies['tutti_known_demo_8080_olga'][0]}"}
        for _ in range(20):
            answer = await gateway.post("/v1/login", {"user": "olga", "password": "wrong password"})
            assert answer.refused in ("wrong-password", "too-many-tries")
        right = {"user": "olga", "password": PASSWORD}
        for headers, status in (({}, 429), ({"cookie": "tutti_known_demo_8080_olga=forged.mark"}, 429), (known, 200)):
            assert (await gateway.post("/v1/login", right, headers)).status == status
        # The mark is no session, and not another user's.
        assert (await gateway.get("/v1/session", known)).status == 401
        assert (
            await gateway.get("/v1/session", {"cookie": f"tutti_session={cookies['tutti_session_demo_8080'][0]}"})
        ).status == 401

    run_with_gateway(main)


@pytest.mark.parametrize("allowed", [False, True])
def test_a_stop_needs_no_user_where_the_fleet_file_says_so(tmp_path: Path, allowed: bool) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, **USERS)
        await asyncio.sleep(3.0)  # until the fleet file is known
        client = fleet.make_client("anna")
        assert (await gateway.get("/v1/sign-in")).json == {"stop": allowed}
        answers = [await gateway.post("/v1/stop") for _ in range(3)]
        assert [answer.status for answer in answers] == ([200, 200, 429] if allowed else [401] * 3)
        await asyncio.sleep(1.0)
        stops = [command for command in await client.list_commands(100) if command.verb == "stop"]
        assert [stop.actor for stop in stops] == ["(not signed in)@127.0.0.1"] * (2 if allowed else 0)
        assert sum("stop by (not signed in)@127.0.0.1" in line for line in gateway.lines) == len(stops)
        # Nothing else is open, and no other page.
        for path in ("/v1/estop", "/v1/reset", "/v1/start-queue", "/v1/submit"):
            assert (await gateway.post(path)).status == 401
        for headers in ({"host": "evil.example:8080"}, {"origin": "http://evil.example"}):
            assert (await gateway.post("/v1/stop", {}, headers)).status == 403
        assert (await gateway.post("/v1/stop", {}, await gateway.sign_in("vera"))).status == 200
        assert (await gateway.post("/v1/stop")).status == (200 if allowed else 401)

    demo = demo_fleet().to_plain()
    run_with_gateway(main, Fleet.model_validate(demo | {"web": {"stop_without_signing_in": allowed}}))


def test_a_repeated_key_is_the_same_request(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        key = {"idempotency-key": "one"}
        first = await gateway.post("/v1/submit", {"job": JOB}, key)
        second = await gateway.post("/v1/submit", {"job": JOB}, key)
        third = await gateway.post("/v1/submit", {"job": JOB}, {"idempotency-key": "two"})
        assert first.json["job_id"] == second.json["job_id"] != third.json["job_id"]
        answer = await gateway.post("/v1/submit", {"job": JOB | {"name": "other"}}, key)
        assert (answer.status, answer.refused) == (409, "key-used")
        assert " by operator@127.0.0.1 for another request" in answer.json["refused"]["text"]

    run_with_gateway(main)


def test_the_key_of_another_user_gives_no_job_of_that_user(tmp_path: Path) -> None:
    """A proposer that guesses the key of tonight's job must not put its own in the place of it."""

    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, **USERS)
        evil, good = JOB | {"name": "evil"}, JOB | {"name": "good"}
        paul, olga = await gateway.sign_in("paul"), await gateway.sign_in("olga")
        for headers in ({"idempotency-key": "nightly-1"}, {}):
            keys = {} if headers else {"client_key": "nightly-1"}
            first = await gateway.post("/v1/submit", {"job": evil, **keys}, {**paul, **headers})
            second = await gateway.post("/v1/submit", {"job": good, **keys}, {**olga, **headers})
            third = await gateway.post("/v1/submit", {"job": good, **keys}, {**olga, **headers})
            assert (first.status, second.status, third.status) == (200, 200, 200)
            assert second.json["entry"]["name"] == "good"
            assert first.json["job_id"] != second.json["job_id"] == third.json["job_id"]
        # Of the same user: another job, or other terms, are refused; its tokens and computers share its keys.
        for body in ({"job": evil}, {"job": good, "terms": {"priority": 3}}):
            answer = await gateway.post("/v1/submit", body | {"client_key": "nightly-1"}, olga)
            assert (answer.status, answer.refused) == (409, "key-used")
            assert " by olga@127.0.0.1 for another request" in answer.json["refused"]["text"]
        assert len((await gateway.get("/v1/jobs", olga)).json["jobs"]) == 4

    run_with_gateway(main)


def test_the_verbs_of_the_queue_and_of_jobs(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        socket = await gateway.connect()
        await gateway.post("/v1/stop-queue")
        ids = [(await gateway.post("/v1/submit", {"job": JOB | {"name": name}})).json["job_id"] for name in "abc"]
        assert (await gateway.post("/v1/reorder", {"job_id": ids[2], "before": ids[0]})).status == 200
        assert (await gateway.post("/v1/hold", {"job_ids": [ids[1]]})).status == 200
        await asyncio.sleep(0.5)
        queue = socket.state["queue"]
        assert [each["name"] for each in queue["jobs"]] == ["c", "a", "b"]
        assert queue["jobs"][2]["held_by"] == "operator@127.0.0.1"
        assert queue["stopped"]["actor"] == "operator@127.0.0.1"
        assert (await gateway.get("/v1/queue")).json["waiting"] == 3
        await gateway.post("/v1/start-queue")
        await asyncio.sleep(5.0)
        listed = (await gateway.get("/v1/jobs?limit=10&state=done")).json
        assert {each["name"] for each in listed["jobs"]} == {"a", "c"}
        shown = (await gateway.get(f"/v1/jobs/{ids[0]}")).json
        assert shown["report"]["state"] == "done"
        assert (await gateway.get("/v1/jobs/none")).status == 404
        assert (await gateway.get("/v1/jobs?limit=many")).status == 400
        assert (await gateway.get("/v1/nothing")).status == 404

    run_with_gateway(main)


def test_what_is_read_of_a_run(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        (tmp_path / "run.mcap").write_bytes(b"123")
        await outcome(fleet, PREPARE)
        job = {"schema": "tutti.job/1", "name": "m", "steps": [{"do": "move", "to": {"gantry.x": 20, "stage.u": 2}}]}
        job_id = (await gateway.post("/v1/submit", {"job": job})).json["job_id"]
        await fleet.make_client().wait_for_job(job_id)
        recording = (await gateway.get(f"/v1/jobs/{job_id}/recording/0")).json
        axis = recording["axes"]["gantry.x"]
        assert axis["planned"]["v"][-1] == pytest.approx(20)
        assert axis["actual"]["v"][-1] == pytest.approx(20, abs=0.01)
        rows = (await gateway.get(f"/v1/jobs/{job_id}/export.csv")).body.decode().splitlines()
        assert rows[0].startswith("step,axis,unit,fleet_ns") and len(rows) > 10
        assert (await gateway.get(f"/v1/jobs/{job_id}/recording/7")).status == 404
        assert (await gateway.get("/v1/recordings")).json["files"][0]["bytes"] == 3
        assert "gantry" in (await gateway.get("/v1/clocks")).json["clocks"]
        frames = (await gateway.get("/v1/trace/gantry")).json["frames"]
        assert frames and {"at_s", "direction", "text", "meaning"} == frames[-1].keys()
        fleet_now = (await gateway.get("/v1/fleet")).json
        assert fleet_now["digests"]["gantry"]["file"] == fleet_now["digests"]["gantry"]["running"]
        assert fleet_now["configuration"]["notify"] is None
        for path in (
            "/v1/alarms?all=1&history=5",
            "/v1/names",
            "/v1/virtual",
            "/v1/zones",
            "/v1/positions",
            "/v1/statistics",
            "/v1/schemas/job",
        ):
            assert (await gateway.get(path)).status == 200, path
        assert (await gateway.get("/v1/schemas/nothing")).status == 404
        assert (await gateway.get("/v1/trace/nothing")).status == 503

    run_with_gateway(main)


def test_all_steps_of_a_job_are_drawn_over_one_time(tmp_path: Path) -> None:
    steps: list[dict[str, Any]] = [
        {"do": "move", "name": "out", "to": {"gantry.x": 20}},
        {"do": "dwell", "duration": "1 s"},
        {"do": "scan", "axes": {"gantry.x": {"from": 22, "to": 26, "points": 3}}},
    ]

    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        await outcome(fleet, PREPARE)
        job = {"schema": "tutti.job/1", "name": "m", "steps": steps}
        job_id = (await gateway.post("/v1/submit", {"job": job})).json["job_id"]
        assert (await gateway.get(f"/v1/jobs/{job_id}/plot")).status == 404  # nothing has moved
        await fleet.make_client().wait_for_job(job_id)
        drawing = (await gateway.get(f"/v1/jobs/{job_id}/plot")).json
        assert [step["index"] for step in drawing["steps"]] == [0, 2, 3, 4]
        assert [step["text"] for step in drawing["steps"]][:2] == ["step 1", "step 3, point 1 of 3"]
        assert drawing["steps"][0]["t0"] == 0 and drawing["steps"][0]["name"] == "out"
        assert drawing["steps"][1]["t0"] >= drawing["steps"][0]["t1"] + 1
        assert drawing["left_out"] == 0
        axis = drawing["axes"]["gantry.x"]
        assert axis["planned"]["v"][-1] == pytest.approx(26)
        for curve in (axis["planned"], axis["actual"]):
            assert curve["t"] == sorted(set(curve["t"])) and len(curve["t"]) == len(curve["v"])
        points = (await gateway.get(f"/v1/jobs/{job_id}/points?step=2&after=1&limit=1")).json["points"]
        assert [(point["point"], point["target"]) for point in points] == [(2, {"gantry.x": 24.0})]
        assert len((await gateway.get(f"/v1/jobs/{job_id}/points")).json["points"]) == 3
        assert (await gateway.get(f"/v1/jobs/{job_id}/points?after=x")).status == 400

    run_with_gateway(main)


def test_a_running_path_is_named_and_drawn(tmp_path: Path) -> None:
    pieces = [{"piece": "arc", "to": [50, 60], "centre": [40, 60]}, {"piece": "line", "to": [50, 20], "corner": "stop"}]
    path = {"do": "path", "axes": ["gantry.x", "gantry.y"], "start": [30, 60], "tolerance": "1 mm", "pieces": pieces}
    steps = [{"do": "move", "to": {"gantry.x": 30, "gantry.y": 60}}, {**path, "speed": "20 mm/s", "corner": "stop"}]

    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        socket = await gateway.connect()
        await outcome(fleet, PREPARE)
        job = {"schema": "tutti.job/1", "name": "m", "max_start_skew": "20 ms", "steps": steps}
        job_id = (await gateway.post("/v1/submit", {"job": job})).json["job_id"]
        while not socket.state.get("paths"):
            await asyncio.sleep(0.1)
        assert socket.state["paths"] == {job_id: {"step": 1, "axes": ["gantry.x", "gantry.y"]}}
        drawing = (await gateway.get(f"/v1/jobs/{job_id}/path/1")).json
        assert drawing["unknown"] is None
        x, y = (drawing["axes"][axis]["v"] for axis in ("gantry.x", "gantry.y"))
        assert (x[0], y[0]) == pytest.approx((30, 60)) and (x[-1], y[-1]) == pytest.approx((50, 20))
        await fleet.make_client().wait_for_job(job_id)
        await asyncio.sleep(0.2)
        assert not socket.state["paths"]
        for step, code in ((0, "no-path"), (2, "no-file")):
            assert (await gateway.get(f"/v1/jobs/{job_id}/path/{step}")).json["refused"]["code"] == code

    run_with_gateway(main)


def test_the_axes_of_a_job_are_those_that_it_names_also_by_a_position(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        await outcome(fleet, PREPARE)
        values = {"gantry.y": "20 mm", "stage.v": "1 mm"}
        saving = {"name": "there", "axes": list(values), "values": values, "description": None}
        assert (await gateway.post("/v1/save-position", saving)).status == 200
        await gateway.post("/v1/stop-queue")
        moves: dict[str, Any] = {"do": "repeat", "times": 2, "steps": [{"do": "move", "to": {"stage.u": 1}}]}
        for steps, axes in (
            ([{"do": "move", "to": "there"}], ["gantry.y", "stage.v"]),
            ([{"do": "enable", "axes": ["gantry"]}, {"do": "dwell", "duration": "1 s"}], ["gantry.x", "gantry.y"]),
            ([moves, {"do": "scan", "axes": {"gantry.x": {"values": [1, 2]}}}], ["stage.u", "gantry.x"]),
        ):
            job = {"schema": "tutti.job/1", "name": "m", "steps": steps}
            job_id = (await gateway.post("/v1/submit", {"job": job})).json["job_id"]
            assert (await gateway.get(f"/v1/jobs/{job_id}/axes")).json == {"axes": axes}
        assert (await gateway.get("/v1/jobs/none/axes")).status == 404

    run_with_gateway(main)


def test_of_a_long_job_the_last_steps_are_drawn(tmp_path: Path) -> None:
    move = {"do": "repeat", "times": 110, "steps": [{"do": "move", "by": {"gantry.x": by}} for by in (1, -1)]}

    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        await outcome(fleet, PREPARE)
        job = {"schema": "tutti.job/1", "name": "m", "steps": [move]}
        job_id = (await gateway.post("/v1/submit", {"job": job})).json["job_id"]
        await fleet.make_client().wait_for_job(job_id)
        drawing = (await gateway.get(f"/v1/jobs/{job_id}/plot")).json
        assert [step["index"] for step in drawing["steps"]] == list(range(20, 220))
        assert drawing["left_out"] == 20
        assert max(len(axis[kind]["t"]) for axis in drawing["axes"].values() for kind in ("planned", "actual")) <= 4000

    run_with_gateway(main)


def test_a_job_file_is_checked_drawn_and_submitted(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        (tmp_path / "scan.job.yaml").write_text((EXAMPLES / "scan.template.job.yaml").read_text())
        (tmp_path / "bad.job.yaml").write_text("steps: [")
        park = "schema: tutti.job/1\nname: park\nbutton: {label: Park, group: Ends}\nsteps:\n  - {do: dwell, duration: 1 s}\n"
        (tmp_path / "park.job.yaml").write_text(park)
        (tmp_path / "lost.job.yaml").write_text(park.replace("1 s", "soon"))
        await outcome(fleet, PREPARE)
        templates = {each["file"]: each for each in (await gateway.get("/v1/templates")).json["templates"]}
        assert [each["name"] for each in templates["scan.job.yaml"]["parameters"]][:2] == ["width", "points"]
        assert templates["bad.job.yaml"]["problem"] and templates["bad.job.yaml"]["button"] is None
        assert templates["scan.job.yaml"]["button"] is None
        button = {"label": "Park", "group": "Ends"}
        assert (templates["park.job.yaml"]["button"], templates["park.job.yaml"]["problem"]) == (button, None)
        assert templates["lost.job.yaml"]["button"] == button and "duration" in templates["lost.job.yaml"]["problem"]
        parked = (await gateway.post("/v1/check-job", {"template": "park.job.yaml"})).json["job"]
        assert parked["name"] == "park" and "button" not in parked
        await fleet.make_client().save_position("sample", "stage.u", "gantry.x")
        body: dict[str, Any] = {"template": "scan.job.yaml", "values": {"width": "30 mm", "lines": "2"}}
        found = (await gateway.post("/v1/check-job", body)).json
        assert not found.get("problems", found)
        assert max(found["preview"]["axes"]["gantry.x"]["v"]) == pytest.approx(30)
        assert found["preview"]["duration_s"] > 1
        assert found["forecast"]["steps"][2]["do"] == "scan"
        assert (await gateway.post("/v1/submit", {"job": found["job"]})).status == 200
        wrong = (await gateway.post("/v1/check-job", body | {"values": {"width": "3 kg", "many": "1"}})).json
        assert wrong["job"] is None and len(wrong["problems"]) == 2
        text = "schema: tutti.job/1\nname: far\nsteps:\n  - {do: move, to: {gantry.x: 9000}}\n"
        far = (await gateway.post("/v1/check-job", {"text": text})).json
        assert (far["problems"][0]["line"], "soft limits" in far["problems"][0]["text"]) == (4, True)
        secret = "schema: tutti.job/1\nname: f\nsteps:\n  - {do: scan, points: {file: /etc/passwd}}\n"
        assert "tutti submit" in (await gateway.post("/v1/check-job", {"text": secret})).json["problems"][0]["text"]
        for bad in ({}, {"text": 5}, {"template": "../x"}, {"text": "a", "template": "b"}, {"text": "a", "values": []}):
            assert (await gateway.post("/v1/check-job", bad)).json.get("refused") or True
        assert (await gateway.post("/v1/check-job", {"template": "../../etc/passwd"})).status == 404

    run_with_gateway(main)


def test_a_fleet_file_is_compared_with_the_running_one(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path, mia="maintainer")
        session = await gateway.sign_in("mia")
        text = (EXAMPLES / "demo.fleet.yaml").read_text()
        same = (await gateway.post("/v1/check-fleet", {"text": text}, session)).json
        assert [each["path"] for each in same["changes"]] == ["positions.park", "positions.sample", "starts"]
        other = text.replace("velocity: 10,", "velocity: 8,", 1)
        found = (await gateway.post("/v1/check-fleet", {"text": other}, session)).json
        change = next(each for each in found["changes"] if "velocity" in each["path"])
        assert change == {"path": "controllers.stage.axes.u.limits.velocity", "from": 10.0, "to": 8.0}
        done = await gateway.post("/v1/reload", {"configuration": found["configuration"]}, session)
        assert done.json["changed"] == ["stage"], done.body
        bad = (await gateway.post("/v1/check-fleet", {"text": text.replace("unit: mm", "unit: miles")}, session)).json
        assert bad["configuration"] is None and bad["problems"][0]["line"] > 0

    run_with_gateway(main)


def test_the_description_for_programs_names_every_verb(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        described = (await gateway.get("/v1/openapi.json")).json
        for verb in SERVICE_VERBS:
            assert "post" in described["paths"][f"/v1/{verb}"]
        text = json.dumps(described)
        for name in described["components"]["schemas"]:
            assert "request_id" not in described["components"]["schemas"][name].get("properties", {})
        for reference in set(text.split('"$ref": "')[1:]):
            assert reference.partition('"')[0].rpartition("/")[2] in described["components"]["schemas"]

    run_with_gateway(main)
