"""`tutti keys …`: the authority of a fleet, and the certificates of its routers, hosts, users and services."""

from collections.abc import Callable
from datetime import UTC, datetime
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from orchestrator.cli.base.common import console, json_option, print_json, print_result
from orchestrator.cli.base.durations import DurationType
from orchestrator.cli.base.errors import expected_errors
from orchestrator.cli.base.extras import require_extra
from orchestrator.keys.names import USER_ROLES

if TYPE_CHECKING:
    from orchestrator.keys.folder import KeyFolder
    from orchestrator.keys.register import RegisterEntry

F = TypeVar("F", bound=Callable[..., Any])

DAY_S = 86_400
RESTART = "the router takes it as soon as the fleet is at rest; a copy of the router's folder must be copied again"

keys_option = click.option(
    "--keys",
    "folder",
    type=click.Path(path_type=Path),
    required=True,
    envvar="TUTTI_KEYS",
    show_envvar=True,
    help="The folder of the fleet's keys.",
)
_NAME = click.argument("name")
_LOOPBACK = ("localhost", "127.0.0.1", "::1")
_addresses_option = click.option(
    "--address", "addresses", multiple=True, help="Name or IP address under which it is reached; repeat it for more."
)


def _lifetime_option(days: int) -> Callable[[F], F]:
    return click.option(
        "--for", "lifetime_s", type=DurationType(), default=f"{days}d", show_default=True, help="Lifetime."
    )


@click.group(epilog="Example: tutti keys init --keys keys --fleet lab --address lab-pc")
def keys() -> None:
    """The keys of a fleet: its own authority, and a certificate for each router, host, user and service.

    The folder of the keys stays where it was made; what a name needs is in its folder `identities/NAME`, to copy to its
    computer and to give to each command: `tutti --identity FOLDER`, or TUTTI_IDENTITY.
    """


@keys.command(epilog="Example: tutti keys init --keys keys --fleet lab --address 192.168.1.5")
@keys_option
@click.option("--fleet", required=True, help="The fleet's name, as in its file.")
@_addresses_option
@_lifetime_option(3650)
@json_option
def init(folder: Path, fleet: str, addresses: tuple[str, ...], lifetime_s: float, *, as_json: bool) -> None:
    """Make the authority of a fleet, and the certificate of its router, which is reached under --address.

    This computer's own names are always among the addresses.
    """
    key_folder = _open(folder)
    with expected_errors():
        register = key_folder.init(_check_fleet(fleet), datetime.now(UTC), lifetime_s / DAY_S)
        entry = key_folder.add("router", "main", datetime.now(UTC), addresses=_own_addresses(addresses))
    value = {"fleet": register.fleet, "authority": register.authority, "router": str(entry.key_name)}
    words = f"the authority of fleet {register.fleet} is in {folder}; its key never leaves that folder\n"
    words += f"router {entry.key_name} is reached under {', '.join(entry.addresses)}\n"
    words += f"next: tutti router FILE --keys {folder} --listen tls/0.0.0.0:7447"
    print_result(value, words, as_json=as_json)


@keys.command("add-router", epilog="Example: tutti keys add-router second --keys keys --address lab-pc-2")
@_NAME
@_addresses_option
@keys_option
@_lifetime_option(397)
@json_option
def add_router(name: str, addresses: tuple[str, ...], folder: Path, lifetime_s: float, *, as_json: bool) -> None:
    """Add one more router, which is reached under --address."""
    _add("router", name, folder, lifetime_s, addresses=addresses or (name,), as_json=as_json)


@keys.command("add-host", epilog="Example: tutti keys add-host lab3 --keys keys")
@_NAME
@keys_option
@_lifetime_option(397)
@json_option
def add_host(name: str, folder: Path, lifetime_s: float, *, as_json: bool) -> None:
    """Add the adapter host NAME, as it is called in the fleet file. It may act on its own controllers only."""
    _add("host", name, folder, lifetime_s, as_json=as_json)


@keys.command("add-gateway", epilog="Example: tutti keys add-gateway page --keys keys --address tutti.lab")
@_NAME
@_addresses_option
@keys_option
@_lifetime_option(397)
@json_option
def add_gateway(name: str, addresses: tuple[str, ...], folder: Path, lifetime_s: float, *, as_json: bool) -> None:
    """Add a gateway whose page other computers open under --address. `localhost`, 127.0.0.1 and ::1 are always
    among them.

    Browsers accept it once they have the fleet's authority, the file ca.pem.
    """
    _add("gateway", name, folder, lifetime_s, addresses=(*(addresses or (name,)), *_LOOPBACK), as_json=as_json)


@keys.command("add-opcua", epilog="Example: tutti keys add-opcua --keys keys --address lab-pc")
@click.argument("name", default="server")
@_addresses_option
@keys_option
@_lifetime_option(397)
@json_option
def add_opcua(name: str, addresses: tuple[str, ...], folder: Path, lifetime_s: float, *, as_json: bool) -> None:
    """Make the certificate of an OPC UA server, which clients reach under --address: `tutti opcua serve
    --certificates`.

    It is self-signed, RSA. Clients get the file cert.der; those that may connect have theirs in the folder `trusted`.
    """
    key_folder = _open(folder)
    from orchestrator.keys.opcua import add_opcua as make_certificate
    from orchestrator.keys.opcua import find_application_uri
    from orchestrator.keys.register import read_register

    with expected_errors():
        _check_name(name)
        fleet = read_register(folder).fleet
        identity = key_folder.identity(f"opcua-{name}")
        expires = make_certificate(identity, fleet, datetime.now(UTC), lifetime_s / DAY_S, _own_addresses(addresses))
    uri = find_application_uri(fleet)
    value = {"identity": str(identity), "application_uri": uri, "expires_utc": f"{expires:%Y-%m-%dT%H:%M:%SZ}"}
    words = f"{uri}, until {expires:%Y-%m-%d}, is in {identity}; give its cert.der to clients, and put theirs in "
    print_result(value, f"{words}{identity / 'trusted'}", as_json=as_json)


@keys.command("add-coordinator", epilog="Example: tutti keys add-coordinator --keys keys")
@click.argument("name", default="main")
@keys_option
@_lifetime_option(397)
@json_option
def add_coordinator(name: str, folder: Path, lifetime_s: float, *, as_json: bool) -> None:
    """Add a coordinator. A standby on the same computer uses the same one."""
    _add("coordinator", name, folder, lifetime_s, as_json=as_json)


@keys.command("add-user", epilog="Example: tutti keys add-user anna --role operator --keys keys")
@_NAME
@click.option(
    "--role",
    type=click.Choice(USER_ROLES),
    required=True,
    help="operator: runs the machine; maintainer: also raw commands; viewer: reads; gateway: the page; recorder: "
    "recordings; estop-button: only stops.",
)
@keys_option
@_lifetime_option(397)
@json_option
def add_user(name: str, role: Any, folder: Path, lifetime_s: float, *, as_json: bool) -> None:
    """Add a user, or a service: gateway, recorder, e-stop button."""
    _add(role, name, folder, lifetime_s, as_json=as_json)


@keys.command(epilog="Example: tutti keys renew host-lab3 --keys keys")
@_NAME
@keys_option
@_lifetime_option(397)
@json_option
def renew(name: str, folder: Path, lifetime_s: float, *, as_json: bool) -> None:
    """Issue the next generation of NAME, e.g. `host-lab3`. No earlier one counts any more.

    The router takes the new table at its next restart; until then the certificate before it counts, and the new one
    does not yet.
    """
    key_folder = _open(folder)
    with expected_errors():
        entry = key_folder.renew(_drop_generation(name), datetime.now(UTC), lifetime_s / DAY_S)
    _print_entry(key_folder, entry, as_json=as_json)


@keys.command(epilog="Example: tutti keys revoke operator-anna --keys keys")
@_NAME
@click.option("--now", is_flag=True, help="Do not wait until the fleet is at rest: it is stopped first.")
@keys_option
@json_option
def revoke(name: str, folder: Path, *, now: bool, as_json: bool) -> None:
    """Take NAME out of the table, e.g. `operator-anna`. It counts until the router has restarted."""
    key_folder = _open(folder)
    with expected_errors():
        entry = key_folder.revoke(_drop_generation(name), at_once=now)
    words = f"{entry.key_name} is revoked; "
    words += "the router stops the fleet, and restarts now" if now else RESTART
    print_result({"name": str(entry.key_name), "revoked": True, "now": now}, words, as_json=as_json)


@keys.command("ls", epilog="Example: tutti keys ls --keys keys --json")
@keys_option
@json_option
def list_keys(folder: Path, *, as_json: bool) -> None:
    """List the names, the generation of each that counts, and when its certificate ends."""
    from rich.table import Table

    from orchestrator.keys.register import read_register

    with expected_errors():
        register = read_register(folder)
    utc = datetime.now(UTC)
    if as_json:
        print_json(
            [
                {"name": str(entry.key_name), **entry.to_plain(), "state": _state_of(entry, utc)}
                for entry in _sort(register)
            ]
        )
        return
    table = Table("name", "role", "expires", "state", "addresses", box=None)
    for entry in _sort(register):
        cells = (str(entry.key_name), entry.role, f"{entry.expires():%Y-%m-%d}", _state_of(entry, utc))
        table.add_row(*cells, ", ".join(entry.addresses))
    console.print(table)


def _sort(register: Any) -> "list[RegisterEntry]":
    return [entry for _, entry in sorted(register.names.items())]


def _state_of(entry: "RegisterEntry", now: datetime) -> str:
    from orchestrator.bus.expiry import describe_expiry

    return "revoked" if entry.revoked else describe_expiry(entry.expires(), now)


def _add(
    role: Any, name: str, folder: Path, lifetime_s: float, *, addresses: tuple[str, ...] = (), as_json: bool
) -> None:
    key_folder = _open(folder)
    with expected_errors():
        _check_name(name)
        entry = key_folder.add(role, name, datetime.now(UTC), lifetime_s / DAY_S, addresses)
    _print_entry(key_folder, entry, as_json=as_json)


def _print_entry(made: "KeyFolder", entry: "RegisterEntry", *, as_json: bool) -> None:
    identity = made.identity(entry.key_name.subject)
    value = {"name": str(entry.key_name), "identity": str(identity), "expires_utc": entry.expires_utc}
    words = f"{entry.key_name}, until {entry.expires():%Y-%m-%d}; hand over the folder {identity}\n{RESTART}"
    print_result(value, words, as_json=as_json)


def _open(folder: Path) -> "KeyFolder":
    require_extra("keys")
    from orchestrator.keys.folder import KeyFolder

    return KeyFolder(folder)


def _check_fleet(fleet: str) -> str:
    from orchestrator.bus.keys import FleetKeys

    try:
        return FleetKeys(fleet).fleet
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="--fleet") from None


def _check_name(name: str) -> None:
    from orchestrator.keys.names import check_name

    try:
        check_name(name)
    except ValueError as error:
        raise click.BadParameter(str(error), param_hint="NAME") from None


def _drop_generation(name: str) -> str:
    """`host-lab3` for `host-lab3.2`, too: names are copied from lists."""
    return name.partition(".")[0]


def _own_addresses(addresses: tuple[str, ...]) -> tuple[str, ...]:
    import socket

    return tuple(dict.fromkeys([*addresses, socket.gethostname(), *_LOOPBACK]))
