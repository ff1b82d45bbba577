"""`tutti ros2 serve`: a fleet for clients of ROS 2."""

from collections.abc import Iterable

import click

from tutti.commands import BAD_INPUT, exit_with_error, fleet_options, is_loopback, json_option, require_extra

OPEN = "ROS 2 has no users here: each client that reaches this router moves the fleet with the rights of this server"
NO_TLS = "clients of ROS 2 have no certificates of the fleet: they need a router of their own"


@click.group(epilog="Example: tutti ros2 serve --domain 7")
def ros2() -> None:
    """Serve a fleet to clients of ROS 2."""


@ros2.command(epilog="Example: tutti ros2 serve --ros-router tcp/127.0.0.1:7448 --joint shoulder=arm.a")
@fleet_options
@json_option
@click.option("--ros-router", metavar="ENDPOINT", help="The Zenoh router of ROS 2; that of the fleet if left out.")
@click.option("--domain", type=click.IntRange(0, 232), envvar="ROS_DOMAIN_ID", show_envvar=True, help="ROS domain.")
@click.option("--namespace", help="Of the node and the action; the name of the fleet if left out.")
@click.option("--joint", "joints", multiple=True, metavar="NAME=AXIS", help="Another name for an axis; repeat it.")
@click.option(
    "--hz", default=20.0, show_default=True, type=click.FloatRange(0.1, 200), help="Joint states a second at most."
)
@click.option(
    "--tolerance", default=1e-3, show_default=True, type=click.FloatRange(1e-9, 1), help="Of a path: m or rad."
)
@click.option("--i-know", is_flag=True, help="Use a router of ROS 2 beyond loopback.")
def serve(  # noqa: PLR0913
    connect: str,
    fleet: str | None,
    ros_router: str | None,
    domain: int | None,
    namespace: str | None,
    joints: tuple[str, ...],
    *,
    hz: float,
    tolerance: float,
    i_know: bool,
    as_json: bool,
) -> None:
    """Publish joint states, and serve the action follow_joint_trajectory, as rmw_zenoh of ROS 2 Jazzy, until Ctrl-C.

    What clients do, it does with its own rights: those of its identity's role. A goal ends with this server.
    """
    router = connect if ros_router is None else ros_router
    if "tls/" in router or "quic/" in router:
        exit_with_error(f"{router}: {NO_TLS}", BAD_INPUT, "give it: --ros-router tcp/127.0.0.1:PORT")
    if ros_router is not None and not i_know and not all(map(is_private, ros_router.split(","))):
        exit_with_error(f"--ros-router {ros_router}: {OPEN}", BAD_INPUT, "give --i-know if that is so")
    names = dict(read_names(joints))
    require_extra("ros2", "rosbags")
    from integrations.ros2.server import serve_ros2
    from integrations.ros2.settings import RosSettings
    from tutti.commands import serve_fleet

    settings = RosSettings(router, domain, namespace.strip("/") if namespace else namespace, names, hz, tolerance)
    serve_fleet(connect, fleet, "ros2", lambda tutti: serve_ros2(tutti, settings), as_json=as_json)


def is_private(endpoint: str) -> bool:
    """Whether only this computer reaches a router; what is no address ends the command."""
    kind, _, address = endpoint.partition("/")
    host = address.rpartition(":")[0].strip("[]")
    return kind.startswith("unix") or host == "localhost" or is_loopback(host)


def read_names(joints: Iterable[str]) -> Iterable[tuple[str, str]]:
    """The names and axes of `--joint`; what is none ends the command."""
    for text in joints:
        name, sign, axis = text.partition("=")
        if not (name and sign and axis):
            exit_with_error(f"--joint {text}: this is no name of an axis", BAD_INPUT, "write NAME=CONTROLLER.AXIS")
        yield name, axis
