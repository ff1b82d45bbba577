"""Product code outside a make's folder names no make but in examples, entry points and benches."""

import re
from pathlib import Path

ROOT = Path(__file__).parents[3]
MAKES = ("smc4000", "smc2000", "shrc203", "ppsmc", "smc30", "cia402", "galil", "ascii")
FOLDERS = {*MAKES, "yaskawa"}
# A word of its own: "SMC30", but not ASCII, which is a character set.
NAMED = re.compile(
    rf"\b({'|'.join(make for make in MAKES if make != 'ascii')})\b|adapters\.ascii|sim\.ascii", re.IGNORECASE
)

EXAMPLES = {
    "orchestrator/runtime/simulated_fleets.py": "fleets of benchmarks, campaign and tests: an example of each make",
    "orchestrator/campaign/fleets.py": "fleets of the campaign: an example of each make",
    "orchestrator/cli/files/fleet.py": "examples in help texts",
    "orchestrator/cli/sim/sim.py": "examples in help texts",
    "orchestrator/cli/sim/serve.py": "examples in help texts",
    "orchestrator/model/fleet.py": "examples in the description of a field",
    "orchestrator/cli/main.py": "examples in help texts",
    "sim/link/process.py": "an example in its docstring",
    "adapters/host/makes.py": "an example in a comment",
    "sim/link/arguments.py": "examples in help texts",
}


def names_a_make(path: Path) -> bool:
    relative = path.relative_to(ROOT)
    return not FOLDERS & set(relative.parts) and NAMED.search(path.read_text(encoding="utf-8")) is not None


def test_only_these_files_outside_a_folder_of_a_make_name_one() -> None:
    product = [
        path
        for package in ("tutti", "orchestrator", "adapters", "sim", "integrations")
        for path in (ROOT / package).rglob("*.py")
    ]
    found = {str(path.relative_to(ROOT)) for path in product if names_a_make(path)}
    found = {name for name in found if not name.startswith(("orchestrator/bench/", "benches/"))}  # benches of makes
    assert found == set(EXAMPLES)
