"""Large values in parts: what takes them from another process, or writes them, does other work between two parts.

A path of 100,000 pieces took 1.3 s to decode and 0.5 s to encode at once, in which a coordinator sent no heartbeat.
"""

import io
import pickle
from collections.abc import Generator, Iterable, Mapping, Sequence
from typing import Any, cast

from orchestrator.model.base import Model
from orchestrator.model.jobs.job import Job
from orchestrator.model.paths.packed import PART_ITEMS, PackedPieces
from orchestrator.model.paths.pieces import LinePiece
from orchestrator.model.steps.base import Step
from orchestrator.model.steps.path import FollowPath
from orchestrator.model.steps.tree import find_paths


class _PartPickler(pickle.Pickler):
    """Pickles a value without its long lists, which become parts of their own."""

    def __init__(self, file: io.BytesIO, parts: list[bytes]) -> None:
        super().__init__(file, pickle.HIGHEST_PROTOCOL)
        self._parts = parts

    def persistent_id(self, obj: Any) -> tuple[int, ...] | None:
        """The numbers of the parts of a long list."""
        if type(obj) is not list:
            return None
        items = cast(list[Any], obj)
        if len(items) <= PART_ITEMS:
            return None
        begins = range(0, len(items), PART_ITEMS)
        return tuple(_pickle_part(items[begin : begin + PART_ITEMS], self._parts) for begin in begins)


def _pickle_part(value: Any, parts: list[bytes]) -> int:
    file = io.BytesIO()
    _PartPickler(file, parts).dump(value)
    parts.append(file.getvalue())
    return len(parts) - 1


def split_value(value: Any) -> list[bytes]:
    """A value as parts for another process of this program; the last one is the value itself."""
    parts: list[bytes] = []
    _pickle_part(value, parts)
    return parts


class _PartUnpickler(pickle.Unpickler):
    def __init__(self, part: bytes, values: Mapping[int, list[Any]]) -> None:
        super().__init__(io.BytesIO(part))
        self._values = values

    def persistent_load(self, pid: tuple[int, ...]) -> list[Any]:
        """The list of the parts with these numbers."""
        return [item for number in pid for item in self._values[number]]


def join_value(parts: Iterable[bytes]) -> Generator[None, None, Any]:
    """Make the value of its parts again: a generator that stops after each part, and returns the value. Only of parts
    of this program's own processes: pickle trusts them."""
    values: dict[int, Any] = {}
    value: Any = None
    for number, part in enumerate(parts):
        values[number] = value = _PartUnpickler(part, values).load()
        yield
    return value


def join_at_once(parts: Iterable[bytes]) -> Any:
    """`join_value` without a stop, beside the loop."""
    joining = join_value(parts)
    while True:
        try:
            next(joining)
        except StopIteration as end:
            return end.value


def find_long_paths(steps: Sequence[Step]) -> list[tuple[FollowPath, PackedPieces]]:
    """The long paths among steps, and inside of them, with their pieces."""
    return [(path, path.pieces) for path in find_paths(steps) if isinstance(path.pieces, PackedPieces)]


def has_long_path(model: Model) -> bool:
    """Whether a job, or the field `job` of a model, has a path that takes long to write."""
    return bool(_find_long_paths(model))


def dump_long(model: Model, exclude: Mapping[str, Any] | None = None) -> bytes:
    """The JSON of a job, or of a model with a field `job`, as `model_dump_json` writes it; pieces of long paths are
    copied, and become no objects."""
    paths = _find_long_paths(model)
    if not paths:
        return model.model_dump_json(exclude=exclude).encode()
    marks = [LinePiece.model_construct(to=[f"\0{number}"]) for number in range(len(paths))]
    marked_paths = {
        id(path): path.model_copy(update={"pieces": [mark]}) for (path, _), mark in zip(paths, marks, strict=True)
    }
    job = _find_job(model)
    assert job is not None
    short_job = job.model_copy(update={"steps": [step.replace_steps(marked_paths) for step in job.steps]})
    short_model = short_job if model is job else model.model_copy(update={"job": short_job})
    text = short_model.model_dump_json(exclude=exclude).encode()
    for (_, pieces), mark in zip(paths, marks, strict=True):
        text = text.replace(mark.to_json(), pieces.to_json()[1:-1], 1)
    return text


def _find_job(model: Model) -> Job | None:
    job = model if isinstance(model, Job) else getattr(model, "job", None)
    return job if isinstance(job, Job) else None


def _find_long_paths(model: Model) -> list[tuple[FollowPath, PackedPieces]]:
    job = _find_job(model)
    return [] if job is None else find_long_paths(job.steps)
