"""A driver of your own against a simulated SMC-4000: a plain socket, the simulator as a process, nothing else of Tutti.

own_driver.py
"""

import json
import socket
import subprocess
import tempfile
from pathlib import Path
from typing import Any


class Smc4000:
    """A driver in a few lines: one command, one reply, which ends with a colon, or with a question mark if refused."""

    def __init__(self, host: str, port: int) -> None:
        self.link = socket.create_connection((host, port), timeout=5)

    def ask(self, command: str) -> str:
        """Send a command; return its reply without the colon."""
        self.link.sendall(f"{command}\r".encode())
        reply = b""
        while reply[-1:] not in (b":", b"?"):
            reply += self.link.recv(1024)
        if reply.endswith(b"?"):
            raise RuntimeError(f"{command} is refused; its error code: {self.ask('TC1')}")
        return reply[:-1].decode().strip()

    def move(self, distance: int) -> int:
        """Move axis X by counts; return its position when it is at rest."""
        for command in ("SHX", f"PRX={distance}", "BGX"):
            self.ask(command)
        while float(self.ask("MG_BGX")):
            pass
        return int(self.ask("TPX"))


def serve(state: str) -> "tuple[subprocess.Popen[str], dict[str, Any]]":
    """Start a simulated controller; return its process, and where it listens."""
    command = ["tutti", "sim", "serve", "smc4000", "--state", state, "--truth", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    assert process.stdout is not None
    lines: list[str] = []
    while not lines or lines[-1].rstrip() not in ("}", ""):
        lines.append(process.stdout.readline())
    return process, json.loads("".join(lines))


with tempfile.TemporaryDirectory() as folder:
    process, served = serve(folder)
    try:
        (place,) = served["links"]
        driver = Smc4000(place["host"], place["port"])
        print("moved to", driver.move(2000))
        subprocess.run(["tutti", "sim", "limit", "smc4000.x", "forward", "--state", folder], check=True)
        try:
            driver.move(2000)
        except RuntimeError as error:
            print(error)
    finally:
        process.terminate()
        process.wait()
    for line in Path(place["controllers"][0]["truth"]).read_text(encoding="utf-8").splitlines():
        print("truth:", line)
