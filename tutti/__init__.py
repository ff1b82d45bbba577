"""The Python interface of Tutti, for scripts, notebooks and programs.

from tutti import BlockingTutti

with BlockingTutti() as tutti:
    tutti.home()
    tutti.move({"gantry.x": 120, "stage.u": "6 mm"})

`Tutti` is the same with `async`. A request that is not carried out raises `Refusal`, with `code`, `text` and `remedy`;
a job that is not done raises `JobFailed`, with its `report`. Both are a `TuttiError`.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from tutti.public import *  # noqa: F403


def __getattr__(name: str) -> Any:
    """What is public is imported with the first name that is used: `tutti.commands` and `tutti.testing` need less."""
    if name == "__version__":
        return import_module("importlib.metadata").version("tutti")
    public = import_module("tutti.public")
    if name == "__all__" or name in public.__all__:
        return getattr(public, name)
    raise AttributeError(f"module 'tutti' has no attribute {name!r}")
