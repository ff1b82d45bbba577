"""Write a message of each key, as it is on the wire, to `tests/compat/MAJOR.MINOR/`: `golden_messages.py [--write]`.

Those of the present version (`orchestrator/model/version.py`) are written when that version is released;
without `--write` only what would change is named. Those of earlier versions are never written again.
"""

import json
import sys
from pathlib import Path

TESTS = Path(__file__).parents[1] / "tests"


def main() -> int:
    """Return 1 if something would change."""
    sys.path[:0] = [str(TESTS), str(TESTS / "contract")]
    from compat.messages import record_messages

    from orchestrator.model.version import PROTOCOL

    folder = TESTS / "compat" / str(PROTOCOL)
    texts = {
        f"{name.key}.{name.part}.json": json.dumps(json.loads(payload), ensure_ascii=False, indent=1) + "\n"
        for name, payload in record_messages().items()
    }
    known = {path.name: path.read_text(encoding="utf-8") for path in folder.glob("*.json")}
    differing = sorted(name for name in texts.keys() | known.keys() if texts.get(name) != known.get(name))
    sys.stdout.write("".join(f"{name}\n" for name in differing) or "nothing changes\n")
    if "--write" not in sys.argv:
        return int(bool(differing))
    folder.mkdir(exist_ok=True)
    for name in known.keys() - texts.keys():
        (folder / name).unlink()
    for name, text in texts.items():
        (folder / name).write_text(text, encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
