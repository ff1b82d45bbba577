"""Print the points of a scan as they come into a file that still grows: read_growing_hdf5.py FILE [SECONDS].

`tutti job points JOB --hdf5 FILE --follow` writes the file. It needs h5py alone, and ends with the job, or when nothing
has come for SECONDS (60).
"""

import sys
import time
from pathlib import Path

import h5py

GROWS = 0
path = Path(sys.argv[1])
patience_s = float(sys.argv[2]) if len(sys.argv) > 2 else 60.0
deadline = time.monotonic() + patience_s
while not path.exists():
    if time.monotonic() > deadline:
        raise SystemExit(f"{path} has not come within {patience_s:g} s")
    time.sleep(0.05)

with h5py.File(path, "r", swmr=True) as file:
    columns = file["points"]
    shown = ["point", *(name for name in columns if name.endswith((" target", " measured"))), "verdict"]
    print(*shown, sep=",", flush=True)
    done = 0
    while True:
        # First whether it ends: what was written before that is found below.
        file["status"].refresh()
        status = int(file["status"][0])
        file["rows"].refresh()
        count = int(file["rows"][0])  # written last: all columns have as many values
        if count > done:
            for name in shown:
                columns[name].refresh()
            parts = (columns[name][done:count] for name in shown)
            for values in zip(*parts, strict=True):
                print(*(text.decode() if isinstance(text, bytes) else text for text in values), sep=",", flush=True)
            done, deadline = count, time.monotonic() + patience_s
        elif status != GROWS:
            break
        elif time.monotonic() > deadline:
            raise SystemExit(f"nothing has come for {patience_s:g} s; {done} points so far")
        time.sleep(0.05)
print(f"{done} points; {'complete' if status == 1 else 'the writer has ended before the job'}", file=sys.stderr)
