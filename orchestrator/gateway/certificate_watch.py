"""The watch on the page's certificate: it is taken anew when its files change, and its end is announced."""

import ssl
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from orchestrator.bus.expiry import describe_expiry, find_priority
from orchestrator.bus.log import ProcessLog
from orchestrator.clock.base import NS_PER_S, Clock, sleep_ns
from orchestrator.clock.executor import Executor
from orchestrator.gateway.certificate import WebCertificate, read_web_certificate
from orchestrator.gateway.reach import list_names_beyond
from orchestrator.model.errors import Refusal
from orchestrator.model.operation.alarms import AlarmRequest
from orchestrator.model.queue import parse_utc

LOOK_NS = 60 * NS_PER_S  # an alarm that is not repeated for two minutes is over


@dataclass(slots=True)
class CertificateWatch:
    """Watches one certificate.

    context: of the server. admit: lets the gateway answer to these names, besides its own computer's; for none of them
    the reason. raise_alarm: publishes it. beyond: other computers reach the gateway.
    """

    certificate: WebCertificate
    clock: Clock
    execute: Executor
    log: ProcessLog
    context: ssl.SSLContext
    admit: Callable[[Sequence[str], str], None]
    raise_alarm: Callable[[AlarmRequest], None]
    beyond: bool
    _fault: str = ""

    async def run(self) -> None:
        """Watch until cancelled."""
        while True:
            await self._read_again()
            self._judge()
            time_left = self.certificate.expires - parse_utc(self.clock.utc())
            left_ns = int(time_left.total_seconds() * NS_PER_S)
            await sleep_ns(self.clock, min(LOOK_NS, left_ns) if left_ns > 0 else LOOK_NS)

    async def _read_again(self) -> None:
        """Take over what the files are now; where they cannot be used, the present one stays."""
        present = self.certificate
        try:
            current = await self.execute(read_web_certificate, present.file, present.key)
            if current.digest != present.digest:
                current.load_into(self.context)
                self.certificate = current
                self.log.info(f"the page has another certificate, until {current.expires:%Y-%m-%d %H:%M} UTC")
            self._fault = ""
        except Refusal as error:
            if not self._fault:
                self.log.warning(f"the present certificate of the page stays: {error.text}")
            self._fault = error.text

    def _judge(self) -> None:
        """Answer to the names of the certificate while it counts, and announce its end."""
        certificate, utc = self.certificate, parse_utc(self.clock.utc())
        if self.beyond:
            over = utc >= certificate.expires
            reason = f"its certificate has expired on {certificate.expires:%Y-%m-%d %H:%M} UTC" if over else ""
            self.admit(() if over else list_names_beyond(certificate), reason)
        priority = find_priority(certificate.expires, utc)
        text = f"the certificate of the page {describe_expiry(certificate.expires, utc)}"
        text = f"{text} ({certificate.expires:%Y-%m-%d %H:%M} UTC)"
        action = f"renew it (`tutti keys renew`, or its authority), and replace {certificate.file} and its key"
        if self._fault:
            priority, text, action = priority or "medium", self._fault, "put both files there again"
        if priority is not None:
            self.raise_alarm(
                AlarmRequest(
                    kind="certificate", subject="page", text=text, action=action, priority=priority, active=True
                )
            )
