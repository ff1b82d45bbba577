"""Put what stands in a file on keys, as fast as this process can: `flood.py ENDPOINT FILE KEY…`; `?KEY` is requested.

It has the lowest priority, and the identity of its environment. When its standard input ends it prints how much it put.
"""

import os
import sys
import threading
from pathlib import Path

import zenoh

from orchestrator.bus.zenoh.sessions import open_session


def main() -> None:
    endpoint, file, *keys = sys.argv[1:]
    os.nice(19)
    session = open_session(endpoint)
    payload, put, ended = Path(file).read_bytes(), 0, threading.Event()
    threading.Thread(target=lambda: (sys.stdin.read(), ended.set()), daemon=True).start()
    sys.stdout.write("ready\n")
    sys.stdout.flush()
    while not ended.is_set():
        for key in keys:
            if key.startswith("?"):
                session.get(key[1:], lambda _: None, payload=payload, timeout=1.0)
            else:
                session.put(key, payload, congestion_control=zenoh.CongestionControl.BLOCK)
        put += len(keys)
    sys.stdout.write(f"{put}\n")
    sys.stdout.flush()
    os._exit(0)  # what is still queued is not waited for


if __name__ == "__main__":
    main()
