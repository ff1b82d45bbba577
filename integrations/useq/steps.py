"""The events of a sequence as steps of a job.

Events that follow each other with the same outputs are one scan over their positions; a time plan is a pause until an
instant since the beginning of the job. What the sequence has and the mapping has nothing for is listed by name: nothing
is left out in silence.
"""

from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import Any

from useq import AcquireImage, MDAEvent, MDASequence

from integrations.useq.mapping import COORDINATES, MicroscopeMap
from tutti import TuttiError

MAX_EVENTS = 1_000_000


class UnmappedSequence(TuttiError, ValueError):
    """A sequence that cannot be a job. problems: each with its place and a remedy."""

    def __init__(self, problems: Sequence[str]) -> None:
        super().__init__("; ".join(problems))
        self.problems = list(problems)


@dataclass(frozen=True, slots=True)
class _Setting:
    """What is the same for events that are one scan. lit: the output of the channel; exposure_ms: of the camera's
    trigger, None: nothing is triggered. since_s: they begin so long after the job."""

    lit: str | None
    exposure_ms: float | None
    since_s: float


def make_steps(sequence: MDASequence, mapping: MicroscopeMap, exposure_ms: float | None) -> list[dict[str, Any]]:
    """The steps of a sequence, as a job file has them. exposure_ms: for events that state none. Raises
    `UnmappedSequence`."""
    rows: list[tuple[_Setting, tuple[float, ...]]] = []
    problems: dict[str, None] = {}
    coordinates: dict[str, float] = {}
    for number, event in enumerate(sequence.iter_events()):
        if number == MAX_EVENTS:
            raise UnmappedSequence([f"the sequence has more than {MAX_EVENTS:,} events; write it in parts"])
        problems |= dict.fromkeys(_list_problems(event, mapping))
        if not isinstance(event.action, AcquireImage):
            continue
        coordinates |= {name: value for name in mapping.axes if (value := getattr(event, f"{name}_pos")) is not None}
        lacking = [name for name in mapping.axes if name not in coordinates]
        if lacking:
            problems[
                f"event {dict(event.index)}: no {', '.join(lacking)}; give its position, or leave it out of the mapping"
            ] = None
            continue
        setting, more_problems = _make_setting(event, mapping, exposure_ms)
        problems |= dict.fromkeys(more_problems)
        rows.append((setting, tuple(coordinates[name] for name in mapping.axes)))
    if problems:
        raise UnmappedSequence(list(problems))
    if not rows:
        raise UnmappedSequence(["the sequence has no image to take; give it positions, channels or a time plan"])
    return list(_write_steps(rows, mapping))


def _list_problems(event: MDAEvent, mapping: MicroscopeMap) -> Iterator[str]:
    """What an event has, and the mapping has nothing for."""
    for name in COORDINATES:
        if getattr(event, f"{name}_pos") is not None and name not in mapping.axes:
            yield from _explain(
                name, f"its events have positions of {name}", f"map it: {name}=CONTROLLER.AXIS", mapping
            )
    if not isinstance(event.action, AcquireImage):
        yield from _explain("autofocus", f"it has {event.action.type}", "a fleet has none", mapping)
        return
    if mapping.camera is None:
        yield from _explain("camera", "it takes images", "map its trigger: camera=CONTROLLER.OUTPUT", mapping)
    if event.channel is not None and event.channel.config not in mapping.channels:
        name = f"channel.{event.channel.config}"
        yield from _explain(
            name, f"it has channel {event.channel.config}", f"map it: {name}=CONTROLLER.OUTPUT", mapping
        )
    for name, value in (("properties", event.properties), ("slm_image", event.slm_image), ("roi", event.roi)):
        if value:
            yield from _explain(name, f"it sets {name}", "a fleet has none", mapping)
    if event.keep_shutter_open:
        yield from _explain(
            "shutter", "it keeps a shutter open between events", "outputs of channels switch at each", mapping
        )


def _explain(name: str, text: str, remedy: str, mapping: MicroscopeMap) -> Iterator[str]:
    if name not in mapping.ignored:
        yield f"{text}: {remedy}, or --ignore {name}"


def _make_setting(event: MDAEvent, mapping: MicroscopeMap, exposure_ms: float | None) -> tuple[_Setting, list[str]]:
    """What the outputs do at an event, and what is wrong with that."""
    problems: list[str] = []
    lit = None if event.channel is None else mapping.channels.get(event.channel.config)
    exposure = event.exposure or exposure_ms
    if mapping.camera is not None and exposure is None:
        channel = "" if event.channel is None else f" of channel {event.channel.config}"
        problems.append(f"no exposure{channel} is stated: write it there, or give --exposure")
    since_s = 0.0 if "time" in mapping.ignored else event.min_start_time or 0.0
    return _Setting(lit, exposure if mapping.camera is not None else None, since_s), problems


def _write_steps(
    rows: Iterable[tuple[_Setting, tuple[float, ...]]], mapping: MicroscopeMap
) -> Iterator[dict[str, Any]]:
    lit: str | None = None
    begun_s = 0.0
    for setting, group in groupby(rows, key=lambda row: row[0]):
        if setting.since_s > begun_s:
            if lit is not None:
                yield {"do": "output", "output": lit, "value": False}
                lit = None
            yield {"do": "dwell", "duration": f"{setting.since_s:.9g} s", "since_begin": True}
            begun_s = setting.since_s
        if lit not in (None, setting.lit):
            yield {"do": "output", "output": lit, "value": False}
        if setting.lit not in (None, lit):
            yield {"do": "output", "output": setting.lit, "value": True}
        lit = setting.lit
        yield from _write_positions([position for _, position in group], setting, mapping)
    if lit is not None:
        yield {"do": "output", "output": lit, "value": False}


def _write_positions(
    positions: Sequence[tuple[float, ...]], setting: _Setting, mapping: MicroscopeMap
) -> Iterator[dict[str, Any]]:
    shots: list[dict[str, Any]] = []
    if setting.exposure_ms is not None:
        shots.append(
            {"do": "output", "output": mapping.camera, "value": True, "pulse": f"{setting.exposure_ms:.9g} ms"}
        )
    if not mapping.axes:
        for _ in positions:
            yield from shots
        return
    scan: dict[str, Any] = {
        "do": "scan",
        "points": {"axes": list(mapping.axes.values()), "rows": [_shorten(position) for position in positions]},
    }
    yield scan | ({"at_each": shots} if shots else {})


def _shorten(position: tuple[float, ...]) -> list[float]:
    """Positions without the last digits that sums of steps leave."""
    return [round(value, 9) for value in position]
