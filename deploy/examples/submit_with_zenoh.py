"""Submit a job and wait for its report, using only Zenoh: submit_with_zenoh.py JOB.json FLEET [ENDPOINT]."""

import json
import sys
import uuid
from pathlib import Path

import zenoh

endpoint = sys.argv[3] if len(sys.argv) > 3 else "tcp/127.0.0.1:7447"
root = f"tutti/v1/{sys.argv[2]}"
config = zenoh.Config()
config.insert_json5("mode", '"client"')
config.insert_json5("connect/endpoints", json.dumps([endpoint]))
config.insert_json5("scouting/multicast/enabled", "false")


def ask(session: zenoh.Session, key: str, **request: object) -> dict[str, object]:
    """Send one request and return the reply; a refusal ends the program and prints the remedy."""
    payload = json.dumps({"request_id": uuid.uuid4().hex, "actor": "zenoh", **request})
    for reply in session.get(f"{root}/{key}", payload=payload, timeout=10.0):
        if reply.ok is None:
            sys.exit(f"invalid request: {reply.err.payload.to_string()}")
        answer = json.loads(reply.ok.payload.to_string())
        if answer["refused"]:
            sys.exit(f"{answer['refused']['text']}; {answer['refused']['remedy']}")
        return answer
    sys.exit(f"no reply on {root}/{key}: is that fleet up?")


with zenoh.open(config) as session, session.declare_subscriber(f"{root}/job/*/report") as reports:
    job = json.loads(Path(sys.argv[1]).read_text(encoding="utf-8"))
    # The same client_key identifies the same job: keep it to repeat the request when the reply is lost.
    job_id = ask(session, "svc/submit", client_key=uuid.uuid4().hex, job=job)["job_id"]
    for sample in reports:
        report = json.loads(sample.payload.to_string())
        if report["job_id"] == job_id:
            print(job_id, report["state"], report["reason"])
            sys.exit(0 if report["state"] == "done" else 1)
