"""The fork server of the live tests: what it forks is like a fresh interpreter."""

import os
import signal
import subprocess
import sys
import time

import pytest
from children import LIMIT_S
from forks import ForkedProcess, run_forked

pytestmark = pytest.mark.live

SHOW = """
import os, signal, sys, threading
print([signal.getsignal(each) for each in (signal.SIGINT, signal.SIGHUP, signal.SIGPIPE, signal.SIGTERM)])
print(sys.argv, __name__, os.getcwd(), os.environ["SHOWN"], threading.active_count(), repr(sys.stdin.read()))
print([each for each in os.listdir("/proc/self/fd") if int(each) > 3])
sys.stderr.write("error")
sys.exit(7)
"""


def test_a_forked_process_is_like_a_fresh_one() -> None:
    arguments, environment = ["-c", SHOW, "a", "b c"], {**os.environ, "SHOWN": "yes"}
    forked = run_forked(arguments, environment, LIMIT_S)
    command = [sys.executable, *arguments]
    fresh = subprocess.run(command, env=environment, stdin=subprocess.DEVNULL, capture_output=True, text=True)
    assert (forked.returncode, forked.stdout, forked.stderr) == (fresh.returncode, fresh.stdout, fresh.stderr)
    assert forked.returncode == 7 and "default_int_handler" in forked.stdout


def test_its_pipes_signals_and_end_are_those_of_a_process() -> None:
    code = "import sys\nfor line in sys.stdin: print(line.upper(), end='', flush=True)"
    echo = ForkedProcess(["-c", code], os.environ)
    assert echo.stdin is not None and echo.stdout is not None
    echo.stdin.write("a line\n")
    echo.stdin.flush()
    assert echo.stdout.readline() == "A LINE\n"
    assert echo.poll() is None
    with pytest.raises(subprocess.TimeoutExpired):
        echo.wait(0.01)
    assert echo.communicate(LIMIT_S) == ("", "") and echo.poll() == 0
    for number in (signal.SIGTERM, signal.SIGKILL):
        sleeper = ForkedProcess(["-c", "import time\ntime.sleep(600)"], os.environ)
        sleeper.send_signal(number)
        assert sleeper.wait(LIMIT_S) == -number
        sleeper.kill()  # it has ended: nothing is sent
        sleeper.communicate()
    begun_s = time.monotonic()
    with pytest.raises(subprocess.TimeoutExpired):
        run_forked(["-c", "import time\ntime.sleep(600)"], os.environ, 0.2)
    assert time.monotonic() - begun_s < LIMIT_S
