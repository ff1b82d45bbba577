"""Optional parts of Tutti: what they need, and how it is installed."""

from importlib.util import find_spec

# The packages of each extra in pyproject.toml, by the names under which they are imported.
_EXTRAS = {
    "record": ("mcap", "zstandard", "prometheus_client"),
    "export": ("mcap", "zstandard", "pyarrow", "h5py"),
    "keys": ("cryptography",),
    "web": ("starlette", "uvicorn", "websockets", "argon2"),
}


def find_missing(extra: str) -> tuple[str, str] | None:
    """What an extra needs and is not installed, and the remedy; None if nothing is missing."""
    missing_modules = [name for name in _EXTRAS[extra] if find_spec(name) is None]
    if not missing_modules:
        return None
    return f"not installed: {', '.join(missing_modules)}", f"install it: pip install 'tutti[{extra}]'"
