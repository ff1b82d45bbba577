"""The lines of a described controller in words: those that its description names."""

import re

from adapters.ascii.description import Description
from adapters.ascii.patterns import LinePattern
from adapters.toolkit.frames import DecodedFrame, FrameDirection, TextDecoder, printable_text

_SINGLE = 3  # characters: a stop or a query of so many may come without an end of line


class DescribedDecoder(TextDecoder):
    """Names queries, stops, procedures, refusals and states."""

    def __init__(self, description: Description) -> None:
        super().__init__()
        self._commands = {
            _bare(text): words
            for text, words in (
                (description.identity.send, "ask identity"),
                (description.status.send, "ask status"),
                (description.session.send, "ask session number"),
                (description.spoiler, "end a half-typed line"),
                *((setting.send, f"ask {setting.item.strip(' ,')}") for setting in description.settings),
                *((step.send, "enable") for step in description.enable),
                *((step.send, "clear alarm") for step in description.clear_alarm),
                *((step.send, "finish the stop") for step in description.finish_stop),
                (description.start.send, "start the loaded move"),
                (description.stop_search or description.stop, "stop the search"),
                (description.stop, "stop"),
            )
            if _bare(text)
        }
        procedures = (
            *((step.send, "load") for step in description.load),
            *((step.send, "search the reference") for step in description.home),
            *((step.send, "jog") for step in description.jog),
            (description.jog_stop, "stop the jog"),
            (description.session.write, "set session number"),
        )
        self._templates = [(_make_pattern(text), words) for text, words in procedures if _bare(text)]
        # These act at once, also within a line.
        self._single = [command for command in self._commands if len(command) < _SINGLE and not command.isalnum()]
        self._states = description.status.states
        self._patterns = [
            (LinePattern(text), words)
            for text, words in (
                (description.refused, "refused"),
                (description.restarted, "has restarted"),
                (description.identity.match, "identity"),
                (description.session.match, "session number"),
                *(
                    (setting.match, setting.item.strip(" ,"))
                    for setting in description.settings
                    if "{" not in setting.match
                ),
                (description.identity.last, "accepted"),
                (description.ignored, "message"),
            )
            if text
        ]
        self._status = LinePattern(description.status.match)

    def decode_bytes(self, direction: FrameDirection, data: bytes) -> list[DecodedFrame]:
        text = printable_text(data)
        if direction == "out" and text in self._single:
            return [DecodedFrame(text, self._commands[text])]
        return super().decode_bytes(direction, data)

    def describe_sent(self, line: str) -> DecodedFrame:
        descriptions = (words for pattern, words in self._templates if pattern.fullmatch(line))
        return DecodedFrame(line, self._commands.get(line) or next(descriptions, ""))

    def describe_received(self, line: str) -> DecodedFrame:
        status = self._status.match(line)
        if status is not None:
            state = status.get("state", "")
            return DecodedFrame(line, f"status: {self._states.get(state, state or status.get('flags', ''))}")
        return DecodedFrame(line, next((words for pattern, words in self._patterns if pattern.matches(line)), "answer"))


def _make_pattern(template: str) -> re.Pattern[str]:
    """What a template becomes when its names are filled in."""
    return re.compile(".+".join(map(re.escape, re.split(r"\{\w+\}", _bare(template)))))


def _bare(text: str) -> str:
    return printable_text(text.strip("\r\n").encode("latin-1", "replace"))
