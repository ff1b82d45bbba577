"""Output where the terminal, or the file, cannot hold all characters: signs get a plain form, never an error."""

import codecs
import sys

# One character for one, so that columns stay columns.
_PLAIN = dict(zip("±→←↑↓▸▶◀■…≤≥−–—━─╸╺µμ°∞·×", "~><^v>><#.<>---=-=-uu*8.x", strict=True))
_HANDLER = "tutti-plain"


def replace_unknown_signs() -> None:
    """Let standard output and standard error replace what their encoding does not have."""
    codecs.register_error(_HANDLER, _replace_signs)
    for stream in (sys.stdout, sys.stderr):
        # A stream that is closed, or is of another kind in tests, has no encoding to adapt.
        reconfigure = getattr(stream, "reconfigure", None)
        if reconfigure is not None and codecs.lookup(stream.encoding).name != "utf-8":
            reconfigure(errors=_HANDLER)


def _replace_signs(error: UnicodeError) -> tuple[str, int]:
    assert isinstance(error, UnicodeEncodeError)
    unknown = error.object[error.start : error.end]
    return "".join(_PLAIN.get(sign, "?") for sign in unknown), error.end
