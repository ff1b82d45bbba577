"""Optional parts of Tutti: what they need, and how it is installed."""

from importlib.util import find_spec

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.errors import exit_with_error

# The packages of each extra in pyproject.toml, by the names under which they are imported. Those of an integration are
# named by its own commands.
_EXTRAS = {
    "record": ("mcap", "zstandard", "prometheus_client"),
    "export": ("mcap", "zstandard", "pyarrow", "h5py"),
    "keys": ("cryptography",),
    "postgres": ("psycopg",),
    "web": ("starlette", "uvicorn", "websockets", "argon2"),
}


def find_missing(extra: str, modules: tuple[str, ...] = ()) -> tuple[str, str] | None:
    """What an extra needs and is not installed, and the remedy; None if nothing is missing. modules: for an extra that
    is not one of this package's own."""
    missing_modules = [name for name in modules or _EXTRAS[extra] if find_spec(name) is None]
    if not missing_modules:
        return None
    return f"not installed: {', '.join(missing_modules)}", f"install it: pip install 'tutti[{extra}]'"


def require_extra(extra: str, *modules: str) -> None:
    """End the command if a part that it needs is not installed. modules: as in `find_missing`."""
    missing_extra = find_missing(extra, modules)
    if missing_extra is not None:
        text, remedy = missing_extra
        exit_with_error(text, BAD_INPUT, remedy, code="not-installed")
