"""The command before its modules are imported."""

import subprocess
import sys

INTERRUPTED = """
import sys

class Interrupt:
    def find_spec(self, name, path=None, target=None):
        if name == {module!r}:
            raise KeyboardInterrupt

sys.meta_path.insert(0, Interrupt())
from orchestrator.cli.entry import main
sys.argv = ["tutti", "status"]
main()
"""


def test_an_interrupt_during_imports_ends_the_command_without_a_traceback() -> None:
    for module in ("click", "orchestrator.cli.base.errors", "orchestrator.client"):
        ended = subprocess.run(
            [sys.executable, "-c", INTERRUPTED.format(module=module)], capture_output=True, text=True, check=False
        )
        assert (ended.returncode, ended.stdout) == (130, ""), ended
        assert ended.stderr.strip() == "tutti: interrupted"
