r"""Text from outside: shown, never obeyed.

A name, a reason or a message of a controller can have characters that a terminal obeys or that change what a reader
sees: escape sequences, line ends, characters that turn the direction of writing (Unicode TR 9) or have no width.
They are shown as escapes, `\x1b` or `\u202e`; new names that have one are refused.
"""

import re

# C0, DEL and C1; soft hyphen; Arabic letter mark; zero width and directional marks; line and paragraph separators;
# embeddings and overrides; word joiner, invisible operators and isolates; byte order mark; annotations; lone halves.
_HIDDEN = "\x00-\x1f\x7f-\x9f\xad\u061c\u180e\u200b-\u200f\u2028-\u202e\u2060-\u206f\ufeff\ufff9-\ufffb\ud800-\udfff"
_HIDDEN_TEXT = re.compile(f"[{_HIDDEN}]")
# The same in UTF-8, as JSON may have it outside of escapes.
_HIDDEN_UTF8 = re.compile(
    rb"\xc2[\x80-\x9f\xad]|\xd8\x9c|\xe1\xa0\x8e|\xe2\x80[\x8b-\x8f\xa8-\xae]|\xe2\x81[\xa0-\xaf]"
    rb"|\xef\xbb\xbf|\xef\xbf[\xb9-\xbb]|\x7f"
)
_JSON_ESCAPE = re.compile(rb"\\(?:u([0-9a-fA-F]{4})|.)", re.DOTALL)
_SHORT = {9: "\\t", 10: "\\n", 13: "\\r"}
_SHORT_ESCAPES = {b"\\b", b"\\f", b"\\n", b"\\r", b"\\t"}


def show_text(text: str) -> str:
    r"""The text with an escape for each character that would be obeyed or not be seen: `\x1b`, `\n`, `\u202e`."""
    return _HIDDEN_TEXT.sub(_show_character, text)


def _show_character(match: re.Match[str]) -> str:
    code = ord(match[0])
    return _SHORT.get(code, f"\\x{code:02x}" if code < 0x100 else f"\\u{code:04x}")


def has_hidden(text: str) -> bool:
    """Whether the text has a character that would be obeyed or not be seen."""
    return _HIDDEN_TEXT.search(text) is not None


def show_json(payload: bytes) -> bytes:
    r"""`show_text` for all texts in JSON, before it is decoded: the escape of a control character becomes the text of
    that escape. What has none is returned as it is."""
    if b"\\" in payload:
        payload = _JSON_ESCAPE.sub(_show_escape, payload)
    if not payload.isascii() or b"\x7f" in payload:
        payload = _HIDDEN_UTF8.sub(_show_utf8, payload)
    return payload


def _show_escape(match: re.Match[bytes]) -> bytes:
    if match[1] is None:
        return b"\\" + match[0] if match[0] in _SHORT_ESCAPES else match[0]
    character = chr(int(match[1], 16))
    # The halves of a pair belong together; a lone one is refused by the decoder.
    if "\ud800" <= character <= "\udfff" or not has_hidden(character):
        return match[0]
    return b"\\" + show_text(character).encode()


def _show_utf8(match: re.Match[bytes]) -> bytes:
    return b"\\" + show_text(match[0].decode()).encode()


def explain_hidden(name: str) -> str:
    """What is wrong with a new name that has a character that is not seen or would be obeyed; empty: nothing."""
    match = _HIDDEN_TEXT.search(name)
    if match is None:
        return ""
    text = f'"{show_text(name)[:60]}" has a character that is not shown, {_show_character(match)}, at'
    return f"{text} {match.start() + 1}; remove it"
