"""`python -m sim.core MODEL FILE [--only ID]`: the vector runner on its own, without the rest of Tutti."""

import argparse
import sys
from pathlib import Path

from sim.core.vectors import check_file


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m sim.core", description=__doc__)
    parser.add_argument("model")
    parser.add_argument("file", type=Path)
    parser.add_argument("--only")
    arguments = parser.parse_args()
    report = check_file(arguments.model, arguments.file, arguments.only)
    for failures in report.failures.values():
        for failure in failures:
            sys.stdout.write(
                f"{failure.vector} ({failure.lines})\n  sent     {failure.sent!r}\n"
                f"  expected {failure.expected}\n  received {failure.received}\n"
            )
    sys.stdout.write(f"{len(report.passed)} passed, {len(report.failures)} failed\n")
    return 1 if report.failures else 0


if __name__ == "__main__":
    raise SystemExit(main())
