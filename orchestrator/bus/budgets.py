"""What a message on each key may have: bytes, fields and values, counted before anything is decoded.

A decoder collects every mistake before it reports one, and a process that decodes does nothing else: 3.5 MB of unknown
fields silenced a coordinator for half a second, and the axes stop without it. So each request is bounded by what it can
need (`docs/decisions/0043-budget-before-decoding.md`). The figures stand alone, without the models of the verbs, so
that the path of an e-stop loads none.
"""

from functools import lru_cache
from typing import Literal, NamedTuple

KB, MB = 1_000, 1_000_000

MessageKind = Literal["request", "sample", "answer"]


class WorkBudget(NamedTuple):
    """The most that one message may have.

    max_bytes: on the wire. max_fields, max_values: its colons and commas, those in texts too; an upper bound of its
    fields and values that costs nothing to count. remedy: what to do about a larger one.
    """

    max_bytes: int
    max_fields: int = 20_000
    max_values: int = 20_000
    remedy: str = "send only the fields that the key has, and names as they are in the fleet file"

    def find_excess(self, payload: bytes) -> str:
        """In what the message exceeds the budget, in words with limit and size; empty: in nothing."""
        if len(payload) > self.max_bytes:
            return self.describe_size(len(payload))
        if (fields := payload.count(b":")) > self.max_fields:
            return f"a request has at most {self.max_fields} fields here, this one {fields}; {self.remedy}"
        if (values := payload.count(b",")) > self.max_values:
            return f"a request has at most {self.max_values} values here, this one {values}; {self.remedy}"
        return ""

    def describe_size(self, size: int) -> str:
        """What is said of a message of `size` bytes that is too large."""
        return f"a request has at most {self.max_bytes} bytes here, this one {size}; {self.remedy}"


_SPLIT_JOB = "split the job, or put points of scans beforehand (`svc/put-points`), as `tutti submit` does"
_SPLIT_MOVE = "split the step, or let its path have fewer points"
_SPLIT_NAMES = "name groups or controllers, or send several requests"

QUERY = WorkBudget(1 * KB)
"""Of a request for a value: most have no payload, a trace has three numbers."""
USUAL = WorkBudget(4 * KB)
NAMES = WorkBudget(256 * KB, remedy=_SPLIT_NAMES)
"""Of a request with lists of names: ten thousand jobs, all axes of a fleet."""
AXES = WorkBudget(64 * KB)
"""Of a request with axes of one controller."""
STOP = WorkBudget(64 * KB)
"""Wide, because a stop must not fail by its reason, which is cut."""
JOB = WorkBudget(13 * MB, 800_000, 1_600_000, _SPLIT_JOB)
"""A path of 100,000 pieces has 9 MB; a client sends at most 12 MB."""
FLEET = WorkBudget(4 * MB, 200_000, 200_000, "a fleet of so many controllers needs to be divided")
CONTROLLER = WorkBudget(1 * MB, remedy="leave out what the fleet file does not need for this controller")
MOTION = WorkBudget(4 * MB, 20_000, 400_000, _SPLIT_MOVE)
"""The profiles of a step for all controllers of an adapter host."""

SERVICE_BUDGETS: dict[str, WorkBudget] = {
    "submit": JOB,
    "ask-live": JOB,
    "dry-run": JOB,
    "reload": FLEET,
    "put-points": WorkBudget(1 * MB, remedy="send the points in parts of at most 700,000 bytes"),
    "hold": NAMES,
    "release": NAMES,
    "preview-start": NAMES,
    "acknowledge": NAMES,
    "acquire-axes": NAMES,
    "save-position": NAMES,
    "stop": STOP,
}
"""Of `svc/{verb}`; of all others `USUAL`."""

COMMAND_BUDGETS: dict[str, WorkBudget] = {
    "propose": MOTION,
    "arm": MOTION,
    "start-at-once": MOTION,
    "load-chunk": MOTION,
    "configure": CONTROLLER,
    "lease": AXES,
    "check-settings": AXES,
    "enable": AXES,
    "home": AXES,
    "jog": AXES,
    "begin-sampling": AXES,
    "raw": WorkBudget(32 * KB, remedy="send a command of at most 4,000 characters"),
    "stop": STOP,
    "reset": STOP,
}
"""Of `ctl/{id}/cmd/{verb}`; of all others `USUAL`."""

BATCH = NAMES
"""Of `host/{host}/cmd/{verb}`, unless one part of it may have more."""

POINT_BYTES = 1 * MB
"""Of rows of points: 500 of them, of two axes, have some 300 kB, and with the longest names of 32 axes more than
this."""

_SMALL, _STATE = 16 * KB, 256 * KB
SAMPLE_BYTES: dict[str, int] = {
    "ctl/state": _STATE,
    "ctl/event": _STATE,
    "ctl/clock": _SMALL,
    "ctl/link": _SMALL,
    "leader": _SMALL,
    "estop": _SMALL,
    "estop-reset": _SMALL,
    "session": 64 * KB,
    "lease": _SMALL,
    "alarm": _SMALL,
    "alarm-request": _SMALL,
    "job/state": 64 * KB,
    "job/points": POINT_BYTES,
    "queue": 4 * MB,
    "log": 64 * KB,
}
"""Of what is published, by the first and the last part of its key; of all other keys what the process takes."""

ANSWER_BYTES: dict[str, int] = {
    "ctl/state": _STATE,
    "ctl/event": 4 * MB,
    "ctl/clock": _SMALL,
    "ctl/info": 1 * MB,
    "ctl/trace": 1 * MB,
    "ctl/cmd": 1 * MB,
    "host/cmd": 4 * MB,
    "time": _SMALL,
    "leads": _SMALL,
    "kept-estop": _SMALL,
    "lease": _SMALL,
    "alarm": _SMALL,
}
"""Of answers, likewise."""

LONG_ANSWERS = ("take-samples", "take-triggers")
"""Commands whose answers have what a controller has recorded: as much as the process takes."""


@lru_cache(maxsize=4096)
def find_request_budget(key: str) -> WorkBudget | None:
    """The budget of a request on a key; None: the key is none of a fleet."""
    chunks = _split_key(key)
    match chunks:
        case ["svc", verb]:
            return SERVICE_BUDGETS.get(verb, USUAL)
        case ["ctl", _, "cmd", verb]:
            return COMMAND_BUDGETS.get(verb, USUAL)
        case ["host", _, "cmd", verb]:
            return max(BATCH, COMMAND_BUDGETS.get(verb, BATCH), key=lambda budget: budget.max_bytes)
        case []:
            return None
        case _:
            return QUERY


def find_most_bytes(kind: MessageKind, key: str, process_bytes: int) -> int:
    """The most bytes that a process takes of a message on `key`. process_bytes: what it takes of any message."""
    if kind == "request":
        budget = find_request_budget(key)
        return process_bytes if budget is None else min(budget.max_bytes, process_bytes)
    table = SAMPLE_BYTES if kind == "sample" else ANSWER_BYTES
    return min(table.get(_name_kind(key), process_bytes), process_bytes)


def describe_large_request(key: str, size: int, process_bytes: int) -> str:
    """The refusal of a request of `size` bytes by a process that takes `process_bytes` of any message."""
    budget = find_request_budget(key) or USUAL
    max_bytes = find_most_bytes("request", key, process_bytes)
    return f"too large: {budget._replace(max_bytes=max_bytes).describe_size(size)}"


def is_estop_key(key: str) -> bool:
    """Whether a sample on `key` is an e-stop, also one that cannot be read."""
    return _name_kind(key) == "estop"


@lru_cache(maxsize=4096)
def _name_kind(key: str) -> str:
    """The kind of a key in the tables: `ctl/state`, `job/state`, `leader`."""
    match _split_key(key):
        case ["ctl" | "host" as group, _, "cmd", verb]:
            return f"{group}/{verb if verb in LONG_ANSWERS else 'cmd'}"
        case ["ctl" | "job" as group, _, leaf]:
            return f"{group}/{leaf}"
        case [group, *_]:
            return group
        case _:
            return ""


def _split_key(key: str) -> list[str]:
    """The parts of a key below its fleet; none for a key that is not of a fleet."""
    chunks = key.split("/")
    return chunks[3:] if chunks[:2] == ["tutti", "v1"] else []
