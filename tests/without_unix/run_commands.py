"""Runs commands of `tutti` in one process: a JSON list of words on each line of the input; the answer is a line too, with
exit code and output. A process for each would compute more than the commands do."""

import json
import sys

from click.testing import CliRunner

from orchestrator.cli.main import main

if __name__ == "__main__":
    for line in sys.stdin:
        words = json.loads(line)
        result = CliRunner().invoke(main, words["words"], prog_name="tutti", input=words["input"])
        text = (
            result.output
            if result.exception is None or isinstance(result.exception, SystemExit)
            else repr(result.exception)
        )
        print(json.dumps({"code": result.exit_code, "text": text}), file=sys.__stdout__, flush=True)
