"""Forks Python processes that have their modules already: `python fork_server.py CONTROL_FD`.

Half of what the live tests computed was interpreters that imported the same modules. A request is one packet: what to
run, its environment and folder, and four descriptors: a socket for its end, and its standard input, output and error.
Back come its process id, and at its end its exit code, as `subprocess` has it. It ends with its control socket, and its
children with it.
"""

import gc
import json
import os
import runpy
import selectors
import signal
import socket
import sys
from contextlib import suppress
from importlib import import_module
from pathlib import Path
from typing import Any

MAX_REQUEST = 1 << 20
# What the processes run; they themselves are run again in each.
RUN = (
    "sim.link.process",
    "adapters.host.guardian",
    "adapters.host.host_process",
    "orchestrator.bus.zenoh.router",
    "orchestrator.gateway.process",
)
# Of the commands: what most of them import.
IMPORTED = (
    "orchestrator.bus.zenoh.bus",
    "orchestrator.cli.manual.axis",
    "orchestrator.cli.machine.clock",
    "orchestrator.cli.view.fleet",
    "orchestrator.cli.files.fleet",
    "orchestrator.cli.jobs.job",
    "orchestrator.cli.main",
    "orchestrator.cli.jobs.queue",
    "orchestrator.cli.sim.sim",
    "orchestrator.cli.machine.up",
    "orchestrator.monitor.recording.reader",
    "sim.ascii",
    "sim.cia402",
    "sim.shrc203",
    "sim.yaskawa",
    "tutti",
)


def import_all() -> None:
    for name in (*RUN, *IMPORTED):
        import_module(name)
    for name in RUN:
        del sys.modules[name]


def serve(control: socket.socket) -> dict[str, Any] | None:
    """Fork for every request. Returns in the child, with the request; in the server at the end, with None."""
    children: dict[int, tuple[int, socket.socket]] = {}
    with selectors.DefaultSelector() as selector:
        selector.register(control, selectors.EVENT_READ)
        while True:
            for key, _ in selector.select():
                if key.fileobj is control:
                    data, fds, _, _ = socket.recv_fds(control, MAX_REQUEST, 4)
                    if not data:
                        for pid, _ in children.values():
                            os.kill(pid, signal.SIGKILL)
                        return None
                    pid = os.fork()
                    if pid == 0:
                        leave_server(control, children, fds)
                        return json.loads(data)
                    ended = socket.socket(fileno=fds[0])
                    ended.send(str(pid).encode())
                    for fd in fds[1:]:
                        os.close(fd)
                    pidfd = os.pidfd_open(pid)
                    children[pidfd] = pid, ended
                    selector.register(pidfd, selectors.EVENT_READ)
                else:
                    selector.unregister(key.fd)
                    pid, ended = children.pop(key.fd)
                    os.close(key.fd)
                    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
                    with ended, suppress(OSError):  # perhaps nothing waits for it any more
                        ended.send(str(code).encode())


def leave_server(control: socket.socket, children: dict[int, tuple[int, socket.socket]], fds: list[int]) -> None:
    """In the child: nothing of the server is open, and the signals are those of a fresh interpreter."""
    control.close()
    for pidfd, (_, ended) in children.items():
        os.close(pidfd)
        ended.close()
    os.close(fds[0])
    for number, fd in enumerate(fds[1:]):
        os.dup2(fd, number)
        os.close(fd)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def run(request: dict[str, Any]) -> None:
    """Run what the interpreter would run with these arguments."""
    os.environ.clear()
    os.environ.update(request["environment"])
    os.chdir(request["folder"])
    kind, *rest = request["arguments"]
    paths = [each for each in os.environ.get("PYTHONPATH", "").split(os.pathsep) if each]
    sys.path[:0] = [request["folder"] if kind == "-m" else "", *paths]
    if kind == "-m":
        sys.argv = rest
        runpy.run_module(rest[0], run_name="__main__", alter_sys=True)
    elif kind == "-c":
        sys.argv = ["-c", *rest[1:]]
        exec(compile(rest[0], "<string>", "exec"), {"__name__": "__main__"})
    else:
        sys.argv = [kind, *rest]
        sys.path[0] = str(Path(kind).parent)
        runpy.run_path(kind, run_name="__main__")


if __name__ == "__main__":
    # Ctrl-C ends the tests, which end this.
    for number in (signal.SIGINT, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)
    sys.path.pop(0)
    import_all()
    gc.freeze()
    found = serve(socket.socket(fileno=int(sys.argv[1])))
    if found is not None:
        run(found)
