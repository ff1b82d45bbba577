"""The example files: in the checkout, or where the installation of Tutti has put them."""

from importlib import metadata
from pathlib import Path

from orchestrator.model.errors import TuttiError

_CHECKOUT = Path(__file__).resolve().parents[2] / "deploy" / "examples"


class ExamplesMissing(TuttiError):
    """The installation has no example files."""


def find_example(name: str) -> Path:
    """The example file `name`, e.g. `demo.fleet.yaml`. Raises `ExamplesMissing`."""
    if _CHECKOUT.is_dir():
        return _CHECKOUT / name
    for each in metadata.files("tutti") or []:
        if each.parts[-4:] == ("share", "tutti", "examples", name):
            return Path(str(each.locate())).resolve()
    raise ExamplesMissing(f"this installation of Tutti has no example {name}; install it again from its wheel")
