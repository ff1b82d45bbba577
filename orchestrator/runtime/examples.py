"""The example files: in the checkout, or where the installation of Tutti has put them."""

from importlib import metadata
from pathlib import Path

from orchestrator.model.errors import TuttiError

_CHECKOUT = Path(__file__).resolve().parents[2] / "deploy" / "examples"


class ExamplesMissing(TuttiError):
    """The installation has no example files."""


def find_example(name: str) -> Path:
    """The example `name`: a file, e.g. `demo.fleet.yaml`, or a folder. Raises `ExamplesMissing`."""
    if _CHECKOUT.is_dir():
        return _CHECKOUT / name
    path_end = ("share", "tutti", "examples", name)
    for file in metadata.files("tutti") or []:
        if file.parts[-4:] == path_end:
            return Path(str(file.locate())).resolve()
        if file.parts[-5:-1] == path_end:
            return Path(str(file.locate())).resolve().parent
    raise ExamplesMissing(f"this installation of Tutti has no example {name}; install it again from its wheel")
