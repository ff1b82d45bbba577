"""Zenoh's configuration of a router with TLS, mutual TLS and the access table of a fleet.

The names are those of `DEFAULT_CONFIG.json5` of Zenoh 1.10.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from orchestrator.bus.identity import Identity
from orchestrator.keys.access_table import Rights, find_rights
from orchestrator.keys.register import Register
from orchestrator.model.errors import Refusal
from orchestrator.model.fleet import Fleet

# The kinds of messages that each right of the table allows.
_MESSAGES = {
    "puts": ("put",),
    "subscribes": ("declare_subscriber",),
    "serves": ("declare_queryable", "reply"),
    "queries": ("query",),
    "tokens": ("liveliness_token",),
    "watches": ("declare_liveliness_subscriber", "liveliness_query"),
}
_ALL_MESSAGES = ("delete", *(message for messages in _MESSAGES.values() for message in messages))
_OUT, _SOCKET = "out", "socket"


def make_tls_settings(identity: Identity) -> dict[str, object]:
    """The settings of the router's TLS: certificates of the fleet's authority on both sides."""
    return {
        "transport/link/tls": {
            "root_ca_certificate": str(identity.authority.absolute()),
            "listen_certificate": str(identity.certificate.absolute()),
            "listen_private_key": str(identity.key.absolute()),
            "connect_certificate": str(identity.certificate.absolute()),
            "connect_private_key": str(identity.key.absolute()),
            "enable_mtls": True,
            "close_link_on_expiration": True,
        }
    }


def make_access_settings(register: Register, fleet: Fleet) -> dict[str, object]:
    """The settings of the access control. Several routers carry for each other: a name of one may do everything.
    Raises `Refusal`, code `other-fleet`, if the keys are of another fleet."""
    if register.fleet != fleet.fleet:
        text = f"the keys are of fleet {register.fleet}, and the file is of fleet {fleet.fleet}"
        raise Refusal("other-fleet", text, "give the folder of keys of this fleet")
    hosts = list_controllers(fleet)
    rights = {str(name): find_rights(name, fleet.fleet, hosts) for name in register.admitted()}
    rules: list[dict[str, object]] = [_make_rule(_OUT, "egress", _ALL_MESSAGES, ("**",))]
    # A session through a socket has no certificate: its folder lets the fleet's own user in, and no other.
    rules.append(_make_rule(_SOCKET, "ingress", _ALL_MESSAGES, ("**",)))
    policies: list[dict[str, object]] = [{"rules": [_OUT, _SOCKET], "subjects": [_SOCKET]}]
    linked_routers = [str(name) for name in register.admitted() if name.role == "router"]
    for name, allowed_rights in rights.items():
        carries = name in linked_routers and len(linked_routers) > 1
        own = (
            [_make_rule(name, "ingress", _ALL_MESSAGES, ("**",))]
            if carries
            else list(_list_rules(name, allowed_rights))
        )
        rules += own
        # What a name receives is decided by what it may declare and request.
        policies.append({"rules": [_OUT, *(rule["id"] for rule in own)], "subjects": [name]})
    return {
        "access_control": {
            "enabled": True,
            "default_permission": "deny",
            "rules": rules,
            "subjects": [
                {"id": _SOCKET, "link_protocols": ["unixsock-stream"]},
                *({"id": name, "cert_common_names": [name]} for name in rights),
            ],
            "policies": policies,
        }
    }


def list_controllers(fleet: Fleet) -> dict[str, list[str]]:
    """The controllers of each adapter host."""
    hosts: dict[str, list[str]] = {}
    for name, controller in fleet.controllers.items():
        hosts.setdefault(controller.host, []).append(name)
    return hosts


def nest_settings(settings: Mapping[str, object]) -> dict[str, Any]:
    """The same settings as one object, as a configuration file has them: `a/b` becomes `{a: {b: …}}`."""
    tree: dict[str, Any] = {}
    for path, value in settings.items():
        *outer, last = path.split("/")
        branch = tree
        for part in outer:
            branch = branch.setdefault(part, {})
        branch[last] = value
    return tree


def _list_rules(name: str, rights: Rights) -> Sequence[dict[str, object]]:
    kinds = ((kind, messages, getattr(rights, kind)) for kind, messages in _MESSAGES.items())
    return [_make_rule(f"{name} {kind}", "ingress", messages, keys) for kind, messages, keys in kinds if keys]


def _make_rule(id: str, flow: str, messages: Sequence[str], keys: Sequence[str]) -> dict[str, object]:
    return {
        "id": id,
        "messages": list(messages),
        "flows": [flow],
        "permission": "allow",
        "key_exprs": list(dict.fromkeys(keys)),
    }
