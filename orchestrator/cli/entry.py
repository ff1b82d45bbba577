"""What the command `tutti` runs: an interrupt also ends it quietly while its modules are being imported."""

import sys


def main() -> None:
    """Run the command."""
    try:
        from orchestrator.cli.main import main as run

        run(prog_name="tutti")
    except KeyboardInterrupt:
        print("tutti: interrupted", file=sys.stderr)
        sys.exit(130)
