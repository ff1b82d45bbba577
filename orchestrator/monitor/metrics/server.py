"""The HTTP server of metrics: `/metrics` on this machine, for Prometheus."""

import errno

from prometheus_client import CollectorRegistry, start_http_server

from orchestrator.model.errors import TuttiError

FIRST_PORT, PORTS = 9464, 10
ADDRESS = "127.0.0.1"


class NoPort(TuttiError):
    """Metrics are not served, because no port is free. The text names the ports, and the remedy."""


def serve_metrics(registry: CollectorRegistry, port: int | None) -> str:
    """Serve the metrics in a thread of its own; return their address.

    port: None: the first free one from 9464 on. Raises `NoPort`.
    """
    ports = [port] if port is not None else list(range(FIRST_PORT, FIRST_PORT + PORTS))
    for candidate in ports:
        try:
            start_http_server(candidate, ADDRESS, registry)
        except OSError as error:
            if error.errno not in (errno.EADDRINUSE, errno.EACCES):
                raise
            continue
        return f"http://{ADDRESS}:{candidate}/metrics"
    port_text = f"port {port}" if port is not None else f"ports {FIRST_PORT} to {FIRST_PORT + PORTS - 1}"
    raise NoPort(f"metrics are not served: {port_text} of {ADDRESS} are in use; choose another with --metrics-port")
