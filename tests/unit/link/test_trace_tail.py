"""The last bytes on a link in a log: a line of a log holds them, whatever they are."""

import json
from random import Random

import pytest

from orchestrator.bus.log import MAX_LINE_CHARS
from orchestrator.link.trace import TraceRing


@pytest.mark.parametrize("size", [1, 16, 500, 60_000])
@pytest.mark.parametrize("seed", [1, 2])
def test_the_last_bytes_fit_into_a_line_of_a_log(seed: int, size: int) -> None:
    random, ring = Random(seed), TraceRing()
    for number in range(300):
        data = bytes([random.choice(b"\\\"'\0")]) * size if seed == 1 else random.randbytes(size)
        ring.add_entry(10**18 + number, "in", data)
    tail = ring.tail_text()
    assert tail and len(json.dumps({"trace": tail})) < MAX_LINE_CHARS - 500
    assert tail[-1].startswith(f"{10**18 + 299} in b")
    assert size > 60 or len(tail) > 20
