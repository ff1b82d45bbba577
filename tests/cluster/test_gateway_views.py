"""Views of a part of the fleet by the gateway: needs of a socket, and lists in parts."""

import asyncio
from pathlib import Path
from typing import Any

from cluster.gateway_client import VirtualGateway, run_with_gateway
from cluster.worlds import PREPARE, job, outcome

from orchestrator.runtime.virtual.fleet import VirtualFleet

ALWAYS = {"fleet", "utc", "coordinator", "counts"}


async def open_gateway(fleet: VirtualFleet, folder: Path) -> VirtualGateway:
    gateway = VirtualGateway(fleet, folder)
    await gateway.start()
    return gateway


def test_a_socket_names_what_it_needs_and_changes_it(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        await outcome(fleet, PREPARE)
        socket = await gateway.connect(path="/v1/stream?need=jobs,controllers/gan*&need=alarms")
        assert socket.state.keys() == ALWAYS | {"jobs", "controllers", "alarms"}
        assert list(socket.state["controllers"]) == ["gantry"]
        assert socket.state["counts"]["modes"] == {"idle": 2} and socket.state["counts"]["troubled"] == {}
        assert await socket.ask("need", need=["controllers/stage", "leases"]) == {"answer": 1, "ok": {}}
        await socket.wait_for(lambda: "leases" in socket.state)
        assert socket.state.keys() == ALWAYS | {"leases", "controllers"}
        assert list(socket.state["controllers"]) == ["stage"]
        await asyncio.sleep(1.0)
        assert (socket.whole, socket.gaps) == (2, 0)
        refused = (await socket.ask("need", need=["controllers/", "leases"]))["refused"]
        assert refused["code"] == "bad-request" and "controllers/hall-1*" in refused["remedy"]
        await asyncio.sleep(0.2)
        assert list(socket.state["controllers"]) == ["stage"]  # as before
        await socket.ask("need")
        await socket.wait_for(lambda: "events" in socket.state)
        assert socket.state.keys() == (await gateway.get("/v1/state")).json.keys()

    run_with_gateway(main)


def test_a_socket_that_needs_what_there_is_not_is_refused_before_it_opens(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        socket = await gateway.connect(path="/v1/stream?need=robots")
        assert socket.denied is not None and socket.denied.status == 400
        assert "there is no part 'robots'" in socket.denied.json["refused"]["text"]
        assert gateway.gateway.hub.readers == 0
        nothing = await gateway.connect(path="/v1/stream?need=")
        assert nothing.state.keys() == ALWAYS

    run_with_gateway(main)


async def collect(gateway: VirtualGateway, path: str, field: str) -> list[list[str]]:
    """The parts of a list, by their names or ids."""
    parts: list[list[str]] = []
    answer: dict[str, Any] = {"next": ""}
    while "next" in answer:
        got = await gateway.get(f"{path}&cursor={answer['next']}")
        assert got.status == 200, got.body
        answer = got.json
        parts.append([each if isinstance(each, str) else each["id"] for each in answer[field]])
    return parts


def test_lists_come_in_parts_that_what_changes_meanwhile_does_not_move(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        assert await collect(gateway, "/v1/controllers?limit=1", "controllers") == [["gantry"], ["stage"]]
        assert await collect(gateway, "/v1/controllers?name=s*", "controllers") == [["stage"]]
        assert await collect(gateway, "/v1/controllers?mode=fault", "controllers") == [[]]
        one = (await gateway.get("/v1/controllers?mode=idle&limit=1")).json
        assert one["total"] == 2 and one["controllers"]["gantry"]["axes"]
        client, waits = fleet.make_client(), job("[{do: dwell, duration: 1 s}]")
        ids = [(await client.submit(waits)).id for _ in range(5)]
        ids.reverse()  # the newest first
        assert await collect(gateway, "/v1/jobs?limit=2", "jobs") == [ids[:2], ids[2:4], ids[4:]]
        first = (await gateway.get("/v1/jobs?limit=2")).json
        await client.submit(waits)
        second = (await gateway.get(f"/v1/jobs?limit=2&cursor={first['next']}")).json
        assert [each["id"] for each in second["jobs"]] == ids[2:4]

    run_with_gateway(main)


def test_a_cursor_that_is_none_is_refused_with_the_remedy(tmp_path: Path) -> None:
    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        one = (await gateway.get("/v1/controllers?limit=1")).json["next"]
        for path in ("controllers?cursor=x", "controllers?cursor=%00", f"jobs?cursor={one}"):
            refused = await gateway.get(f"/v1/{path}")
            assert (refused.status, refused.refused) == (400, "bad-request"), path
            assert "leave `cursor` out" in refused.json["refused"]["remedy"]
        for query in ("limit=0", "limit=1001", "limit=x", "name=[a]"):
            refused = await gateway.get(f"/v1/controllers?{query}")
            assert (refused.status, refused.refused) == (400, "bad-request"), query
        gone = await gateway.post("/v1/list", {"before": "no-such-job"})
        assert gone.status == 400 and "begin again" in gone.json["refused"]["text"]

    run_with_gateway(main)
