"""How a fleet is run on a machine: what `tutti up`, its detached form, simulators, tests and benches choose."""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

DEFAULT_PORT = 7447


@dataclass(frozen=True, slots=True)
class WebOptions:
    """host: the address of the page. port: None: the first free one from 8080 on. certificate: PEM
    files of a certificate and its key, for TLS. jobs: the folder of job files that the page offers."""

    host: str = "127.0.0.1"
    port: int | None = None
    certificate: tuple[Path, Path] | None = None
    jobs: Path | None = None

    def list_options(self) -> list[str]:
        """These options as arguments of `tutti up`."""
        options = ["--web-host", self.host]
        options += [] if self.port is None else ["--web-port", str(self.port)]
        options += [] if self.certificate is None else ["--web-cert", *map(str, self.certificate)]
        return [*options, *([] if self.jobs is None else ["--jobs", str(self.jobs)])]


@dataclass(frozen=True, slots=True, kw_only=True)
class FleetRun:
    """How a fleet is run.

    connect: an existing router; without it one is started on `port`.
    simulated: every link is replaced by that of a simulated controller.
    take_over: it leads although another coordinator does.
    truth: simulators record their real motions, in the folder `truth` of the state folder.
    standby: a second coordinator takes over when the first one dies or hangs.
    journal: the address of a journal in a database; empty: a file in the state folder.
    patient: a standby of such a journal lets another one lead first.
    new_journal: a journal is begun although the fleet had one, which is missing.
    first_port: of the simulated controllers on Ethernet; the next ones count up. 0: free ones.
    record_quota: bytes of recordings; None: nothing is recorded, and there are no metrics.
    metrics_port: of the metrics; None: the first free one; 0: none.
    web: how the operators' page is served; None: it is not.
    hosts: the adapter hosts that run here, with their simulators; None: all of them.
    private: the router that is started listens at a socket in the state folder, which only its user reaches.
    keys: the folder of the fleet's keys: each process has the identity of its role.
    """

    connect: str = ""
    port: int = DEFAULT_PORT
    simulated: bool = False
    take_over: bool = False
    truth: bool = False
    standby: bool = False
    journal: str = ""
    patient: bool = False
    new_journal: bool = False
    first_port: int = 0
    record_quota: int | None = None
    metrics_port: int | None = None
    web: WebOptions | None = None
    hosts: frozenset[str] | None = None
    private: bool = False
    keys: Path | None = None

    @classmethod
    def make_simulated(cls, port: int) -> "FleetRun":
        """A simulated fleet whose true motions are recorded, with a router of its own on `port`."""
        return cls(port=port, simulated=True, truth=True)

    def list_options(self) -> Sequence[str]:
        """These options as arguments of `tutti up`."""
        options = ["--connect", self.connect] if self.connect else []
        options += ["--port", str(self.port)]
        options += ["--no-record"] if self.record_quota is None else ["--record-quota", f"{self.record_quota}B"]
        options += [] if self.metrics_port is None else ["--metrics-port", str(self.metrics_port)]
        options += ["--no-hosts"] if self.hosts == frozenset() else []
        options += [part for host in sorted(self.hosts or ()) for part in ("--host", host)]
        options += ["--no-web"] if self.web is None else self.web.list_options()
        options += [] if self.keys is None else ["--keys", str(self.keys)]
        options += ["--journal", self.journal] if self.journal else []
        flags = {"--sim": self.simulated, "--take-over": self.take_over, "--standby": self.standby}
        flags |= {"--truth": self.truth, "--private": self.private, "--new-journal": self.new_journal}
        return [*options, *(name for name, is_given in flags.items() if is_given)]
