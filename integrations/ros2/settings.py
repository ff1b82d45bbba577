"""Settings of the server, by options and by the fleet file. It knows no protocol library."""

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from tutti import Refusal


@dataclass(frozen=True, slots=True)
class RosSettings:
    """router: for ROS 2. domain, namespace: None: as the fleet file says, or 0 and the name of the fleet. joints: of
    names, the axes. hz: messages of a controller a second at most. tolerance: of a path without one, m or rad."""

    router: str
    domain: int | None = None
    namespace: str | None = None
    joints: Mapping[str, str] = field(default_factory=dict[str, str])
    hz: float = 20.0
    tolerance: float = 1e-3


def fill_settings(settings: RosSettings, section: Mapping[str, Any], fleet: str) -> tuple[int, str, dict[str, str]]:
    """Domain, namespace and joints, by the options, the section of the fleet file, and what holds without. Raises
    `Refusal`."""
    unknown_names = section.keys() - {"domain", "namespace", "joints"}
    domain, namespace = section.get("domain", 0), section.get("namespace", make_token(fleet))
    joints = section.get("joints", {})
    domain = domain if settings.domain is None else settings.domain
    namespace = namespace if settings.namespace is None else settings.namespace
    is_good = isinstance(domain, int) and 0 <= domain <= 232 and isinstance(joints, dict)
    is_good = is_good and isinstance(namespace, str) and all(part == make_token(part) for part in namespace.split("/"))
    if unknown_names or not is_good:
        names = f", not {', '.join(sorted(unknown_names))}" if unknown_names else ""
        text = f"`integrations: ros2:` of the fleet file, or an option: domain {domain}, namespace {namespace}"
        remedy = f"domain is 0 to 232, namespace letters, digits, _ and /, joints a map from names to axes{names}"
        raise Refusal("bad-settings", text, remedy)
    return domain, namespace, {**joints, **settings.joints}


def make_token(name: str) -> str:
    """A name as a part of the name of a topic: letters, digits, and _; no digit first."""
    token = re.sub(r"[^A-Za-z0-9_]", "_", name)
    return f"_{token}" if token[:1].isdigit() else token
