"""Publishes states on a broker, as often as is asked for, also after the broker was away."""

import asyncio
import logging
from collections.abc import AsyncGenerator
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime
from ssl import SSLContext

from aiomqtt import Client, MqttError, Will

from integrations.mqtt.topics import Publication, TopicForm
from tutti import Refusal, StateReading, Tutti, running

RETRY_S = 2.0  # until the broker is tried again
LOG = logging.getLogger(__name__)


@dataclass(frozen=True, slots=True)
class BrokerOptions:
    """Where the broker is. tls: None: without. user, password: empty: none."""

    host: str
    port: int
    tls: SSLContext | None = None
    user: str = ""
    password: str = ""


class StatePublisher:
    """Publishes the states of a fleet. period_s: between two messages of a controller at least."""

    def __init__(self, tutti: Tutti, form: TopicForm, options: BrokerOptions, period_s: float) -> None:
        self._tutti = tutti
        self._form = form
        self._options = options
        self._period_s = period_s
        self._newest: dict[str, StateReading] = {}
        self._waiting: set[str] = set()

    @asynccontextmanager
    async def running(self) -> AsyncGenerator[None]:
        """Publish while the context lasts, once the broker is connected. Raises `Refusal`, code `no-broker`, if it does
        not answer at first."""
        connected_event = asyncio.Event()
        async with running(self._follow()), running(self._publish(connected_event)) as publishing:
            async with running(connected_event.wait()) as connecting:
                await asyncio.wait([connecting, publishing], return_when=asyncio.FIRST_COMPLETED)
            if publishing.done():
                publishing.result()
            try:
                yield
            finally:  # its last message is sent before the connection is closed
                publishing.cancel()
                await asyncio.wait([publishing])

    async def _follow(self) -> None:
        async for reading in self._tutti.states():
            self._newest[reading.controller] = reading
            self._waiting.add(reading.controller)

    async def _publish(self, connected_event: asyncio.Event) -> None:
        while True:
            try:
                await self._publish_connected(connected_event)
            except MqttError as error:
                text = f"the broker at {self._options.host}:{self._options.port} does not take messages: {error}"
                if not connected_event.is_set():
                    raise Refusal("no-broker", text, "is it running, and are address, user and TLS right?") from None
                LOG.warning("%s; it is tried again", text)
            await asyncio.sleep(RETRY_S)

    async def _publish_connected(self, connected_event: asyncio.Event) -> None:
        options, will = self._options, self._form.will
        async with Client(
            options.host,
            options.port,
            username=options.user or None,
            password=options.password or None,
            tls_context=options.tls,
            will=Will(will.topic, will.payload, qos=1, retain=will.retained),
        ) as client:
            await self._send(client, self._form.begin(find_utc()))
            connected_event.set()
            self._waiting = set(self._newest)  # all of them anew, for a broker that has forgotten
            try:
                while True:
                    controllers, self._waiting = self._waiting, set()
                    for controller in sorted(controllers):
                        await self._send(client, self._form.take(self._newest[controller]))
                    await asyncio.sleep(self._period_s)
            except asyncio.CancelledError:
                await self._send(client, self._form.end(find_utc()))
                raise

    async def _send(self, client: Client, messages: list[Publication]) -> None:
        for message in messages:
            await client.publish(message.topic, message.payload, qos=1, retain=message.retained)


def find_utc() -> str:
    """The present instant, RFC 3339."""
    return datetime.now(UTC).isoformat()
