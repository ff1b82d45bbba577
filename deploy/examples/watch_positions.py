"""Print live positions of every axis, using only Zenoh: watch_positions.py [ENDPOINT [COUNT OF SAMPLES]]."""

import json
import sys

import zenoh

endpoint = sys.argv[1] if len(sys.argv) > 1 else "tcp/127.0.0.1:7447"
wanted = int(sys.argv[2]) if len(sys.argv) > 2 else sys.maxsize
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
config.insert_json5("scouting/multicast/enabled", "false")
with zenoh.open(config) as session, session.declare_subscriber("tutti/v1/*/ctl/*/state") as states:
    for _, sample in zip(range(wanted), states, strict=False):
        state = json.loads(sample.payload.to_string())
        shown = (f"{axis} {now['position']:.4f} {now['unit']}" for axis, now in state["axes"].items())
        print(state["controller"], state["mode"], *shown, flush=True)
