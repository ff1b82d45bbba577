"""A node of ROS 2 on Zenoh: topics and services by the keys, tokens and attachments of rmw_zenoh_cpp (Jazzy).

Source: github.com/ros2/rmw_zenoh, docs/design.md, liveliness_utils.cpp, attachment_helpers.cpp, rmw_publisher_data.cpp.
"""

import asyncio
import hashlib
import json
import struct
import time
from collections.abc import AsyncGenerator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from itertools import count
from typing import Any

import zenoh
from zenoh import ext

from integrations.ros2.messages import MessageTypes, find_dds_name
from tutti import Refusal

ATTACHMENT = struct.Struct("<qqB16s")
"""Sequence number, time of the source (ns since 1970), length of the GID, GID: by the serializer of zenoh-ext."""
MAX_WAITING = 1000  # requests that are not answered yet
CONNECT_MS = 5000


@dataclass(frozen=True, slots=True)
class Request:
    """A request to a service. message: what is asked. respond: answers it, once."""

    message: Any
    respond: Callable[[Any], None]


def read_request(query: zenoh.Query, types: MessageTypes, service: str) -> Request:
    """Read a request. Raises `ValueError`."""
    payload, attachment = (b"" if part is None else bytes(part) for part in (query.payload, query.attachment))
    if not payload or len(attachment) != ATTACHMENT.size:
        raise ValueError("a request needs a payload, and an attachment with sequence number, time and GID")
    sequence, _, _, gid = ATTACHMENT.unpack(attachment)

    def respond(response: Any) -> None:
        head = ATTACHMENT.pack(sequence, time.time_ns(), len(gid), gid)
        query.reply(query.key_expr, types.encode(response), attachment=head)
        query.drop()

    return Request(types.decode(f"{service}_Request", payload), respond)


class Topic:
    """A topic that this node publishes."""

    def __init__(self, publisher: Any, types: MessageTypes, gid: bytes) -> None:
        self._publisher = publisher
        self._types = types
        self._gid = gid
        self._numbers = count(1)

    @property
    def is_wanted(self) -> bool:
        """Whether there is a subscription; of a topic that is kept not known, and true."""
        return bool(getattr(self._publisher, "matching_status", True))

    def publish(self, message: Any) -> None:
        """Publish a message."""
        head = ATTACHMENT.pack(next(self._numbers), time.time_ns(), len(self._gid), self._gid)
        self._publisher.put(self._types.encode(message), attachment=head)


class RosNode:
    """A node of a session. name: in `namespace`, both without a slash at the ends."""

    def __init__(self, session: zenoh.Session, types: MessageTypes, domain: int, namespace: str, name: str) -> None:
        self.types = types
        self._session = session
        self._domain = domain
        self._names = f"%/%{namespace.replace('/', '%')}/{name}"  # enclave, namespace, node
        self._ids = count(1)
        self._waiting = 0
        self._declared: list[Any] = []  # they end with this object
        self._declare_token(0, "NN", "")

    def publish_on(self, topic: str, type_name: str, *, depth: int = 10, kept: bool = False) -> Topic:
        """Publish messages of a type on a topic, reliably. kept: the last `depth` of them also for subscribers that
        come later (transient local)."""
        key, gid = self._declare("MP", topic, type_name, f":{1 if kept else ''}:,{depth}:,:,:,,")
        if not kept:
            return Topic(self._session.declare_publisher(key), self.types, gid)
        publisher = ext.declare_advanced_publisher(
            self._session,
            key,
            cache=ext.CacheConfig(depth),
            publisher_detection=True,
            sample_miss_detection=ext.MissDetectionConfig(heartbeat=None, sporadic_heartbeat=0.5),
        )
        return Topic(publisher, self.types, gid)

    def serve(self, service: str, type_name: str, answer: Callable[[Request], None]) -> None:
        """Answer requests of a service, in this event loop; what cannot be read is answered by an error."""
        loop = asyncio.get_running_loop()
        key, _ = self._declare("SS", service, type_name, "::,10:,:,:,,")

        def take(query: zenoh.Query) -> None:
            self._waiting -= 1
            try:
                answer(read_request(query, self.types, type_name))
            except ValueError as error:
                refuse(query, str(error))

        def receive(query: zenoh.Query) -> None:
            if self._waiting >= MAX_WAITING:
                refuse(query, f"{MAX_WAITING} requests wait already; send fewer")
            elif not loop.is_closed():
                self._waiting += 1
                loop.call_soon_threadsafe(take, query)

        self._declared.append(self._session.declare_queryable(key, receive, complete=True))

    def _declare(self, kind: str, name: str, type_name: str, qos: str) -> tuple[str, bytes]:
        """Declare the token of a topic or a service; return its key, and the GID of what it is."""
        type_words = f"{find_dds_name(type_name)}/{self.types.find_hash(type_name)}"
        return f"{self._domain}{name}/{type_words}", self._declare_token(
            next(self._ids), kind, f"/{name.replace('/', '%')}/{type_words}/{qos}"
        )

    def _declare_token(self, number: int, kind: str, ending: str) -> bytes:
        zid = self._session.info.zid()
        token = f"@ros2_lv/{self._domain}/{zid}/0/{number}/{kind}/{self._names}{ending}"
        self._declared.append(self._session.liveliness().declare_token(token))
        return hashlib.sha256(token.encode()).digest()[:16]  # of rmw_zenoh XXH3; it has only to be unique


def refuse(query: zenoh.Query, text: str) -> None:
    """Answer a request by an error."""
    query.reply_err(text)
    query.drop()


@asynccontextmanager
async def open_session(router: str) -> AsyncGenerator[zenoh.Session]:
    """A client of the router at `router`, such as tcp/127.0.0.1:7447; of several, with commas between them, the first
    that answers. Raises `Refusal`, code `no-router`."""
    config = zenoh.Config()
    settings: dict[str, object] = {
        "mode": "client",
        "connect/endpoints": router.split(","),
        "connect/timeout_ms": CONNECT_MS,
        "scouting/multicast/enabled": False,
        "scouting/gossip/enabled": False,
        # A cache of an advanced publisher needs the times of what it keeps.
        "timestamping/enabled": True,
    }
    for key, value in settings.items():
        config.insert_json5(key, json.dumps(value))
    try:
        session = await asyncio.to_thread(zenoh.open, config)
    except zenoh.ZError as error:
        text = f"no Zenoh router for ROS 2 answers at {router}: {error}"
        raise Refusal("no-router", text, "start one, or name another one with --ros-router") from None
    try:
        yield session
    finally:
        await asyncio.to_thread(session.close)
