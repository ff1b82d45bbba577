"""`tutti mqtt serve`."""

from contextlib import asynccontextmanager
from pathlib import Path
from typing import TYPE_CHECKING

import click

from tutti.commands import BAD_INPUT, exit_with_error, fleet_options, json_option, require_extra

if TYPE_CHECKING:
    from collections.abc import AsyncGenerator

    from tutti import Tutti
    from tutti.commands import ServerReady


@click.group(epilog="Example: tutti mqtt serve --broker 127.0.0.1:1883")
def mqtt() -> None:
    """Publish states on an MQTT broker."""


@mqtt.command(epilog="Example: tutti mqtt serve --broker broker.lab:8883 --ca ca.pem --user tutti --hz 2")
@fleet_options
@click.option("--broker", default="127.0.0.1:1883", show_default=True, metavar="HOST:PORT", help="The broker.")
@click.option("--prefix", default="tutti", show_default=True, help="Begins all topics.")
@click.option("--sparkplug", metavar="GROUP", help="Topics, births and deaths of Sparkplug B, as JSON, in this group.")
@click.option(
    "--hz", default=1.0, show_default=True, type=click.FloatRange(0.01, 20), help="Messages a second at most."
)
@click.option("--ca", type=click.Path(path_type=Path, exists=True, dir_okay=False), help="TLS, with this authority.")
@click.option("--user", envvar="TUTTI_MQTT_USER", show_envvar=True, default="", help="Of the broker.")
@click.option("--password", envvar="TUTTI_MQTT_PASSWORD", show_envvar=True, default="", help="Better by the variable.")
@json_option
def serve(  # noqa: PLR0913 (the options of a command arrive as its parameters)
    connect: str,
    fleet: str | None,
    broker: str,
    prefix: str,
    sparkplug: str | None,
    *,
    hz: float,
    ca: Path | None,
    user: str,
    password: str,
    as_json: bool,
) -> None:
    """Publish the state of each controller and axis when it changes, until Ctrl-C. Nothing is received.

    Messages are retained; `status` is `offline` when this program is gone.
    """
    require_extra("mqtt", "aiomqtt")
    import ssl

    from integrations.mqtt.publisher import BrokerOptions, StatePublisher
    from integrations.mqtt.topics import PlainForm, SparkplugForm
    from tutti.commands import ServerReady, serve_fleet

    host, _, port = broker.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65_536:
        exit_with_error(f"--broker {broker}: this is no address", BAD_INPUT, "write HOST:PORT, such as 127.0.0.1:1883")
    for option, text in (("--prefix", prefix), ("--sparkplug", sparkplug or "group")):
        if not text.strip("/") or set(text) & set("+#\0") or (option == "--sparkplug" and "/" in text):
            exit_with_error(f"{option} {text}: this cannot begin a topic", BAD_INPUT, "use letters, digits, - and _")
    try:
        context = None if ca is None else ssl.create_default_context(cafile=str(ca))
    except (OSError, ssl.SSLError) as error:
        exit_with_error(f"--ca {ca}: {error}", BAD_INPUT, "give the authority's certificate, as PEM")
    options = BrokerOptions(host.strip("[]"), int(port), context, user, password)

    @asynccontextmanager
    async def start(tutti: "Tutti") -> "AsyncGenerator[ServerReady]":
        name = tutti.keys.fleet
        form = PlainForm(prefix.strip("/"), name) if sparkplug is None else SparkplugForm(sparkplug, name)
        async with StatePublisher(tutti, form, options, 1 / hz).running():
            topics = f"{prefix.strip('/')}/{name}/#" if sparkplug is None else f"spBv1.0/{sparkplug}/+/{name}/#"
            yield ServerReady([f"publishes states of fleet {name} on {broker}, {topics}"], {"topics": topics})

    serve_fleet(connect, fleet, "mqtt", start, as_json=as_json)
