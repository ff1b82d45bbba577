"""`tutti user …`: the users of the page and of the HTTP interface, with their roles, passwords and tokens."""

import sys
from collections.abc import Callable
from pathlib import Path
from secrets import token_urlsafe
from typing import TYPE_CHECKING, Any, TypeVar

import click

from orchestrator.cli.base.codes import BAD_INPUT
from orchestrator.cli.base.common import console, fleet_option, json_option, print_json, print_result, state_option
from orchestrator.cli.base.durations import DurationType
from orchestrator.cli.base.errors import exit_with_error, expected_errors
from orchestrator.cli.base.extras import require_extra

if TYPE_CHECKING:
    from orchestrator.gateway.access.users import UserFile

F = TypeVar("F", bound=Callable[..., Any])

# As in `orchestrator.gateway.access.roles`, which is not imported for the help.
ROLES = ("viewer", "proposer", "operator", "maintainer")
_NAME = click.argument("name")
_ROLE_HELP = (
    "viewer: reads and stops; proposer: submits jobs that wait for approval; operator: runs the machine; "
    "maintainer: also loads fleet files, sends raw commands."
)


def _place_options(command: F) -> F:
    """Options for the state folder that has the users."""
    return state_option(fleet_option("The fleet, if there are several; it need not run.")(command))


def _password_option(command: F) -> F:
    return click.option(
        "--password-stdin", is_flag=True, help="Read the password from the first line of standard input."
    )(command)


@click.group(epilog="Example: tutti user add anna --role operator")
def user() -> None:
    """The users of the operators' page and of the HTTP interface.

    Without users, whatever reaches this machine's own address is an operator. With the first user everyone has to sign
    in. Changes count at once, also in a running fleet.
    """


@user.command(epilog="Example: tutti user add anna --role operator")
@_NAME
@click.option("--role", type=click.Choice(ROLES), required=True, help=_ROLE_HELP)
@click.option("--no-password", is_flag=True, help="Only for programs, by tokens.")
@_password_option
@_place_options
@json_option
def add(
    name: str,
    role: Any,
    state: Path | None,
    fleet: str | None,
    *,
    no_password: bool,
    password_stdin: bool,
    as_json: bool,
) -> None:
    """Add the user NAME, with a password that is asked for."""
    users = _open_users(state, fleet)
    password = "" if no_password else _read_password(from_input=password_stdin)
    with expected_errors():
        is_first = not users.load().users
        users.add_user(name, role, password, _utc())
    words = f"user {name} is {role}" + ("; everyone has to sign in from now on" if is_first else "")
    print_result({"user": name, "role": role, "first": is_first}, words, as_json=as_json)


@user.command("ls", epilog="Example: tutti user ls --json")
@_place_options
@json_option
def list_users(state: Path | None, fleet: str | None, *, as_json: bool) -> None:
    """List the users with roles and tokens."""
    from orchestrator.monitor.tables import make_plain_table
    from orchestrator.monitor.times import format_time

    with expected_errors():
        users = _open_users(state, fleet).load().users
    if as_json:
        print_json([{"name": name, **user.model_dump(mode="json", exclude=_SECRET)} for name, user in users.items()])
        return
    if not users:
        console.print("no users: whatever reaches this machine's own address is an operator", highlight=False)
        return
    table = make_plain_table(["user", "role", "signs in by", "since", "tokens"], ["tokens"])
    for name, user in users.items():
        tokens = ", ".join(
            f"{token} ({stored_token.role}, until {format_time(stored_token.expires_utc)})"
            for token, stored_token in user.tokens.items()
        )
        sign_in = "password" if user.password else "tokens only"
        table.add_row(name, user.role, sign_in, format_time(user.created_utc), tokens or "-")
    console.print(table)


@user.command("rm", epilog="Example: tutti user rm anna")
@_NAME
@_place_options
@json_option
def remove(name: str, state: Path | None, fleet: str | None, *, as_json: bool) -> None:
    """Remove the user NAME with all tokens. What the user has open ends."""
    users = _open_users(state, fleet)
    with expected_errors():
        users.remove_user(name)
        is_last = not users.load().users
    words = f"user {name} is removed"
    if is_last:
        words += "; there are no users any more: whatever reaches this machine's own address is an operator"
    print_result({"user": name, "last": is_last}, words, as_json=as_json)


@user.command(epilog="Example: tutti user passwd anna")
@_NAME
@_password_option
@_place_options
@json_option
def passwd(name: str, state: Path | None, fleet: str | None, *, password_stdin: bool, as_json: bool) -> None:
    """Give the user NAME another password. The user has to sign in again."""
    users = _open_users(state, fleet)
    password = _read_password(from_input=password_stdin)
    with expected_errors():
        users.change_password(name, password, _utc())
    print_result({"user": name}, f"user {name} has a new password", as_json=as_json)


@user.command(epilog="Example: tutti user role anna maintainer")
@_NAME
@click.argument("role", type=click.Choice(ROLES))
@_place_options
@json_option
def role(name: str, role: Any, state: Path | None, fleet: str | None, *, as_json: bool) -> None:
    """Give the user NAME the role ROLE. The user has to sign in again."""
    users = _open_users(state, fleet)
    with expected_errors():
        users.change_role(name, role, _utc())
    print_result({"user": name, "role": role}, f"user {name} is {role}", as_json=as_json)


@user.command(
    epilog="""\b
Examples:
  tutti user token ci --name nightly --role proposer --expires 90d
  tutti user token ci --remove nightly"""
)
@_NAME
@click.option("--name", "token", default="default", show_default=True, help="Of the token.")
@click.option("--role", type=click.Choice(ROLES), default=None, help="At most that of the user, which is the default.")
@click.option("--verb", "verbs", multiple=True, help="Only this verb, e.g. submit; repeat it for others.")
@click.option("--expires", "lifetime_s", type=DurationType("3650d"), default="90d", show_default=True)
@click.option("--remove", default=None, metavar="TOKEN", help="Remove a token instead.")
@_place_options
@json_option
def token(
    name: str,
    token: str,
    role: Any,
    verbs: tuple[str, ...],
    lifetime_s: float,
    remove: str | None,
    state: Path | None,
    fleet: str | None,
    *,
    as_json: bool,
) -> None:
    """Make a token for programs of the user NAME, and print it: it is not stored, and cannot be shown again.

    A program sends it as `Authorization: Bearer TOKEN`.
    """
    users = _open_users(state, fleet)
    with expected_errors():
        if remove is not None:
            users.remove_token(name, remove)
            print_result({"user": name, "removed": remove}, f"token {remove} of {name} is removed", as_json=as_json)
            return
        _make_token(users, name, token, (role, verbs, lifetime_s), as_json=as_json)


def _make_token(
    users: "UserFile", name: str, token: str, rights: tuple[Any, tuple[str, ...], float], *, as_json: bool
) -> None:
    from orchestrator.gateway.access.roles import LEAST_ROLES
    from orchestrator.gateway.access.users import StoredToken
    from orchestrator.model.queue import shift_utc

    role, verbs, lifetime_s = rights
    unknown = sorted(set(verbs) - LEAST_ROLES.keys())
    if unknown:
        exit_with_error(f"no verb {unknown[0]!r}", BAD_INPUT, f"there are: {', '.join(sorted(LEAST_ROLES))}")
    user = users.load().users.get(name)
    chosen_role = role or (user.role if user is not None else "viewer")
    utc = _utc()
    expires = shift_utc(utc, lifetime_s)
    stored_token = StoredToken(
        digest="", role=chosen_role, verbs=list(verbs) or None, created_utc=utc, expires_utc=expires
    )
    secret = users.add_token(name, token, stored_token, token_urlsafe(32))
    value = {"user": name, "name": token, "role": chosen_role, "token": secret, "expires_utc": expires}
    print_result(value, secret, as_json=as_json)


_SECRET: Any = {"password": True, "tokens": {"__all__": {"digest": True}}}


def _open_users(state: Path | None, fleet: str | None) -> "UserFile":
    """The file of users in the state folder that is meant; a fleet that never ran gets its folder."""
    require_extra("web")
    from orchestrator.cli.base.state import choose_state
    from orchestrator.gateway.access.users import UserFile
    from orchestrator.model.files.private_files import make_private_folder
    from orchestrator.runtime.state.folder import LOCK, USERS_FILE, default_state

    with expected_errors():
        if state is not None or fleet is not None:
            folder = state or default_state(fleet or "")
            make_private_folder(folder)
        else:
            folder = choose_state(None, None, LOCK, "state folders")
    return UserFile(folder / USERS_FILE)


def _read_password(*, from_input: bool) -> str:
    """The password: of standard input, or asked for twice. Never an argument: other users of a machine see those."""
    if from_input:
        return sys.stdin.readline().rstrip("\n")
    if not sys.stdin.isatty():
        exit_with_error("there is no terminal to ask for a password", BAD_INPUT, "use --password-stdin")
    return click.prompt("password", hide_input=True, confirmation_prompt=True, err=True)


def _utc() -> str:
    from orchestrator.clock.live import LiveClock

    return LiveClock().utc()
