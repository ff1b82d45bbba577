"""Plug-ins: makes, simulators and kinematics that installed packages provide by entry points, and the version of their
contract.

A plug-in that cannot be used, for whatever reason, is a `PluginError` that names its package, and what to do. Nothing
is imported before it is used: a broken plug-in concerns only what uses it.
"""

import warnings
from collections.abc import Sequence
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, Literal

from orchestrator.model.errors import TuttiError

API_VERSION = 2
"""Version of the contract for makes. A plug-in states the one that it was written for in its attribute `api_version`;
without this attribute it is 1. It rises when a plug-in has to be changed. The one before still loads, for one release,
with a warning."""

SIMULATOR_API_VERSION = 1
"""The same for simulators."""

KINEMATICS_API_VERSION = 1
"""The same for kinematics of virtual axes."""

UNLISTED = ".unlisted"
"""Ends the name of a group whose plug-ins are found by name, and are in no list: those of benchmarks and tests."""

PluginGroup = Literal["tutti.adapters", "tutti.simulators", "tutti.kinematics"]
_KINDS = {"tutti.adapters": "adapter", "tutti.simulators": "simulator", "tutti.kinematics": "kinematics"}
_VERSIONS = {
    "tutti.adapters": API_VERSION,
    "tutti.simulators": SIMULATOR_API_VERSION,
    "tutti.kinematics": KINEMATICS_API_VERSION,
}
_OLDEST = {**_VERSIONS, "tutti.adapters": API_VERSION - 1}
_KNOWN = {"tutti.adapters": "known adapters", "tutti.simulators": "known models", "tutti.kinematics": "installed ones"}


class PluginError(TuttiError, ValueError):
    """A plug-in that cannot be used. remedy: what a person can do."""

    def __init__(self, text: str, remedy: str) -> None:
        super().__init__(f"{text}; {remedy}")
        self.text = text
        self.remedy = remedy


class UnknownPlugin(TuttiError, ValueError):
    """No installed package provides this name."""


@dataclass(frozen=True, slots=True)
class PluginListing:
    """A plug-in as it is installed.

    package: name and version of its package. target: what its entry point refers to.
    problem: why it cannot be used; empty if it can.
    """

    group: PluginGroup
    name: str
    package: str
    target: str
    problem: str = ""


def plugin_names(group: PluginGroup) -> list[str]:
    """Return the names of a group, without importing anything."""
    return sorted({entry.name for entry in entry_points(group=group)})


def load_plugin(group: PluginGroup, name: str, members: Sequence[str]) -> Any:
    """Return the object that is installed as `name`. members: the attributes that it must have.

    Raises `UnknownPlugin` with the known names, `PluginError`.
    """
    kind = _KINDS[group]
    groups = (group, f"{group}{UNLISTED}")
    points = [entry for its_group in groups for entry in entry_points(group=its_group) if entry.name == name]
    if not points:
        raise UnknownPlugin(f"no {kind} {name[:80]!r}; {_KNOWN[group]}: {', '.join(plugin_names(group))}")
    if len(points) > 1:
        packages = " and ".join(sorted(package_of(point) for point in points))
        raise PluginError(
            f"{len(points)} packages provide the {kind} {name}: {packages}",
            "uninstall all but one of them",
        )
    (entry,) = points
    origin = f"the {kind} {name} of package {package_of(entry)} (entry point {entry.value})"
    try:
        plugin: Any = entry.load()
    except (Exception, SystemExit) as error:
        reason = f"{type(error).__name__}: {error}".strip().partition("\n")[0][:300]
        raise PluginError(
            f"{origin} cannot be imported: {reason}", "repair or uninstall this package; `tutti adapter ls` lists all"
        ) from None
    _require_version(plugin, group, origin, package_of(entry))
    missing_members = [member for member in members if not hasattr(plugin, member)]
    if missing_members:
        raise PluginError(f"{origin} has no {', '.join(missing_members)}", "see the contract in `tutti.adapter`")
    version = getattr(plugin, "api_version", 1)
    if version < _VERSIONS[group]:
        remedy = f"install a newer release of {package_of(entry).partition(' ')[0]}"
        text = f"{origin} was written for version {version} of the contract (api_version)"
        warnings.warn(f"{text}; the next release of Tutti does not load it: {remedy}", FutureWarning, stacklevel=2)
    return plugin


def list_plugins(group: PluginGroup, members: Sequence[str]) -> list[PluginListing]:
    """Return all plug-ins of a group, each imported to find out whether it can be used."""
    plugins: list[PluginListing] = []
    for entry in sorted(entry_points(group=group), key=lambda point: point.name):
        problem = ""
        try:
            load_plugin(group, entry.name, members)
        except PluginError as error:
            problem = str(error)
        plugins.append(PluginListing(group, entry.name, package_of(entry), entry.value, problem))
    return plugins


def _require_version(plugin: Any, group: PluginGroup, place: str, package: str) -> None:
    """Raise `PluginError` for a plug-in that was written for a version of the contract that is not loaded."""
    version, present = getattr(plugin, "api_version", 1), _VERSIONS[group]
    if type(version) is not int:
        raise PluginError(f"{place}: api_version is {version!r}", f"it must be a whole number, now {present}")
    if not _OLDEST[group] <= version <= present:
        older = version < present
        raise PluginError(
            f"{place} was written for version {version} of the contract (api_version); this Tutti has {present}",
            f"install a newer release of {package.partition(' ')[0]}"
            if older
            else f"install a newer Tutti, or an older release of {package.partition(' ')[0]}",
        )


def package_of(entry: EntryPoint) -> str:
    """Return name and version of the package that provides an entry point."""
    return "unknown" if entry.dist is None else f"{entry.dist.name} {entry.dist.version}"
