"""Submit a job file and follow it: submit_job.py FILE [ENDPOINT]."""

import sys

from tutti import BlockingTutti, FileError, JobTransition, Refusal, load_job

try:
    with BlockingTutti(sys.argv[2] if len(sys.argv) > 2 else "tcp/127.0.0.1:7447", actor="submit_job") as tutti:
        job = tutti.submit(load_job(sys.argv[1]))
        for event in job.events():
            done = "" if isinstance(event, JobTransition) else f" {event.fraction:4.0%} of step {event.step + 1}"
            print(f"{job.id} {event.state}{done} {event.reason}".rstrip(), flush=True)
        report = job.result()
except Refusal as error:
    sys.exit(f"{error.text}; {error.remedy}")
except FileError as error:
    sys.exit(str(error))
sys.exit(0 if report.state == "done" else 1)
