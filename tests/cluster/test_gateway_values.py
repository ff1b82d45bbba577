"""Every bad value has an answer: all routes and frames, with values of every wrong kind, get a refusal with code and
text, and no defect."""

import random
import re
from contextlib import suppress
from pathlib import Path
from typing import Any, get_args
from urllib.parse import quote

import pytest
from cluster.gateway_client import Answer, VirtualGateway, run_with_gateway
from pydantic import ValidationError

from orchestrator.bus.service_verbs import CONTROLLER_VERBS, SERVICE_VERBS
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.kinds import SingleStep
from orchestrator.model.steps.repeat import Repeat
from orchestrator.runtime.virtual.fleet import VirtualFleet

BIG = 10**400
VALUES: list[Any] = [
    *(None, True, 0, -1, 2**53, 2**63, BIG, 1e308, "", "x", "\ud800", "\x1b[2J", "a/b", "*", "**", "$*", "é" * 300),
    *("9" * 400, [], [[]], [None], ["\ud800"], {}, {"x": 1}, {"\ud800": 1}, [BIG], "1e999", "gantry", "gantry.x"),
]
TEXTS = ["", "x", "99999999999999", "-1", "1e5", "٣", "a b", "*", "**", "$*", "a?b", "#", "%00", "gantry", "é" * 300]
FRAMES = ["acquire", "release", "jog", "renew", "work", "cancel-work", "stop", "estop", "x", "\ud800"]


def draw_fields(draw: random.Random, names: list[str]) -> dict[str, Any]:
    return {name: draw.choice(VALUES) for name in names if draw.random() < 0.7}


async def open_gateway(fleet: VirtualFleet, folder: Path) -> VirtualGateway:
    gateway = VirtualGateway(fleet, folder)
    await gateway.start()
    return gateway


def assert_answer(answer: Answer, *asked: object) -> None:
    """It is no defect, and a refusal has a code."""
    assert answer.status < 500 or answer.refused in ("absent", "no-answer"), (asked, answer)
    assert answer.status < 400 or answer.refused, (asked, answer)


SEEDS = pytest.mark.parametrize("seed", [1, *(pytest.param(seed, marks=pytest.mark.nightly) for seed in range(2, 20))])


@SEEDS
def test_every_path_answers_every_value(tmp_path: Path, seed: int) -> None:
    draw = random.Random(seed)

    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        for path in gateway.gateway.read_paths * 6:
            filled = re.sub(r"{\w+}", lambda _: quote(draw.choice(TEXTS[1:]), safe=""), path)
            query = "&".join(f"{name}={quote(draw.choice(TEXTS))}" for name in ("after", "limit", "state", "since"))
            assert_answer(await gateway.request("GET", f"{filled}?{query}"), filled, query)

    run_with_gateway(main)


@SEEDS
def test_every_verb_answers_every_value(tmp_path: Path, seed: int) -> None:
    draw = random.Random(seed)
    texts = ["text", "parameters", "template", "name", "reason", "user", "password"]
    verbs = {f"/v1/{verb}": [*service.request.model_fields, "more"] for verb, service in SERVICE_VERBS.items()}
    verbs |= {f"/v1/{verb}": texts for verb in ("check-job", "check-fleet", "estop", "reset", "login")}

    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        controllers = {
            f"/v1/controllers/{quote(draw.choice([*TEXTS[1:], 'gantry']), safe='')}/{verb}": [
                *service.request.model_fields
            ]
            for verb, service in CONTROLLER_VERBS.items()
        }
        for path, names in [*verbs.items(), *controllers.items()] * 8:
            body = draw_fields(draw, names)
            assert_answer(await gateway.request("POST", path, body), path, body)

    run_with_gateway(main)


@SEEDS
def test_every_frame_answers_every_value(tmp_path: Path, seed: int) -> None:
    draw = random.Random(seed)

    async def main(fleet: VirtualFleet) -> None:
        gateway = await open_gateway(fleet, tmp_path)
        socket = await gateway.connect()
        for do in FRAMES * 20:
            fields = draw_fields(draw, ["axes", "axis", "velocity", "step", "reason", "holder"])
            if do == "work" and draw.random() < 0.7:
                kind = draw.choice(["move", "home", "enable", "output", "set-position"])
                fields["step"] = {**draw_fields(draw, ["to", "axes", "speed", "axis", "position"]), "do": kind}
            answer = await socket.ask(do, **fields)
            assert "ok" in answer or answer["refused"]["code"] not in ("", "defect"), (do, fields, answer)
        for text in ("", "[]", "{}", '{"do":1}', "\ud800", '{"do":"jog","id":"x"}', f'{{"do":"jog","id":{BIG}}}'):
            other = await gateway.connect()
            other.send_text(text)
            await other.wait_for(lambda socket=other: socket.closed is not None)

    run_with_gateway(main)


@pytest.mark.parametrize("kind", [*get_args(SingleStep), Repeat])
def test_no_number_of_a_step_is_too_large_for_a_refusal(kind: type[Step]) -> None:
    for name in kind.model_fields.keys() - {"do"}:
        for value in (BIG, -BIG, [BIG], {"gantry.x": BIG}, f"{BIG} mm", [[BIG]], {"x": [BIG]}):
            with suppress(ValidationError):
                kind.model_validate({"do": kind.model_fields["do"].default, name: value})
