"""Ports that take connections, refuse them, or answer nothing."""

import socket
from contextlib import ExitStack


def listen(stack: ExitStack) -> int:
    """A port that takes connections."""
    return stack.enter_context(socket.create_server(("127.0.0.1", 0))).getsockname()[1]


def refuse() -> int:
    """A port that nothing listens on."""
    with socket.create_server(("127.0.0.1", 0)) as closing:
        return closing.getsockname()[1]


def be_silent(stack: ExitStack) -> int:
    """A port that answers no further connection, as a computer that is dead: its queue is full."""
    server = stack.enter_context(socket.create_server(("127.0.0.1", 0), backlog=0))
    for _ in range(3):
        client = stack.enter_context(socket.socket())
        client.settimeout(0)
        client.connect_ex(server.getsockname())
    return server.getsockname()[1]
