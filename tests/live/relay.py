"""A relay of TCP connections for tests: `python relay.py LISTEN_PORT HOST PORT`, with commands on standard input.

`cut` closes all connections and refuses new ones; `stall` keeps them, and passes nothing; `deaf` passes nothing towards
the listener's side, `mute` nothing from it; `mend` ends that. Each command is answered with itself.
"""

import asyncio
import sys


class Relay:
    """The relay and its fault."""

    def __init__(self, host: str, port: int) -> None:
        self._place = host, port
        self._writers: set[asyncio.StreamWriter] = set()
        self._passing = {"up": asyncio.Event(), "down": asyncio.Event()}
        self._cut = False
        self.set_fault("mend")

    def set_fault(self, fault: str) -> None:
        self._cut = fault == "cut"
        for way, event in self._passing.items():
            stopped = fault == "stall" or (fault, way) in (("deaf", "down"), ("mute", "up"))
            (event.clear if stopped else event.set)()
        if self._cut:
            for writer in self._writers:
                writer.transport.abort()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        if self._cut:
            writer.transport.abort()
            return
        try:
            far_reader, far_writer = await asyncio.open_connection(*self._place)
        except OSError:
            writer.transport.abort()
            return
        self._writers |= {writer, far_writer}
        await asyncio.gather(self._pass(reader, far_writer, "up"), self._pass(far_reader, writer, "down"))
        self._writers -= {writer, far_writer}

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, way: str) -> None:
        try:
            while data := await reader.read(65_536):
                await self._passing[way].wait()
                writer.write(data)
                await writer.drain()
        except OSError:
            pass
        finally:
            writer.close()


def _say(word: str) -> None:
    sys.stdout.write(f"{word}\n")
    sys.stdout.flush()


async def main(listen: int, host: str, port: int) -> None:
    relay = Relay(host, port)
    commands = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(commands), sys.stdin)
    async with await asyncio.start_server(relay.serve, "127.0.0.1", listen):
        _say("ready")
        while line := await commands.readline():
            relay.set_fault(line.decode().strip())
            _say(line.decode().strip())


if __name__ == "__main__":
    asyncio.run(main(int(sys.argv[1]), sys.argv[2], int(sys.argv[3])))
